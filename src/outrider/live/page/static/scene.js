// The bird's-eye view. Places in a picture are metres from the rider, x and y of the fixed frame.

import { LEVELS, STATES, moves } from "./message.js";

const TAU = 2 * Math.PI;
const RING_M = [2, 5, 10, 20, 50, 100];
const NEAREST_M = 5, FARTHEST_M = 120; // half of the shorter side
const BOUND_S = 1.5; // how far ahead the bound of the followed track is shown
const TAP_M = 2; // beside a box, a tap still means it
const STANDING = 0.5; // m/s; as the warning has it: a slower rider's lane lies along the body

export class Scene {
  constructor(canvas, picked) {
    this.canvas = canvas;
    this.c = canvas.getContext("2d", { alpha: false });
    this.half = 25; // m, half of the shorter side
    this.riderUp = true;
    this.background = null; // { points, origin }
    this.costs = []; // of the last drawings [ms]
    this.colours();
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.touch(picked);
  }

  colours() {
    const style = getComputedStyle(document.documentElement);
    const read = (name) => style.getPropertyValue(`--${name}`).trim();
    this.look = {};
    for (const name of ["ground", "ink", "soft", "line", "point", "wall", "lane", "halo", ...STATES, ...LEVELS])
      this.look[name] = read(name);
    this.font = read("font") || "sans-serif";
  }

  resize() {
    const { canvas } = this, ratio = Math.min(window.devicePixelRatio || 1, 2);
    this.width = canvas.clientWidth;
    this.height = canvas.clientHeight;
    canvas.width = Math.round(this.width * ratio);
    canvas.height = Math.round(this.height * ratio);
    this.ratio = ratio;
    this.draw();
  }

  zoom(factor) {
    this.half = Math.min(Math.max(this.half * factor, NEAREST_M), FARTHEST_M);
    this.draw();
  }

  show(picture, setup, followed) {
    Object.assign(this, { picture, setup, followed });
    this.draw();
  }

  draw() {
    const { c, look } = this;
    if (!this.width) return;
    const begin = performance.now();
    c.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    c.fillStyle = look.ground;
    c.fillRect(0, 0, this.width, this.height);
    if (!this.picture) return;
    this.place();
    this.rings();
    this.standing();
    this.lane();
    const tracks = this.picture.rows;
    for (const track of tracks) this.bound(track);
    for (const track of tracks) if (moves(track)) this.arc(track);
    this.points();
    for (const track of tracks) this.box(track);
    for (const track of tracks) if (moves(track)) this.arrow(track);
    this.rider();
    this.labels(tracks);
    this.costs.push(performance.now() - begin);
    if (this.costs.length > 100) this.costs.shift();
  }

  // Where the middle of the view is, how many pixels a metre has, and what points up.
  place() {
    const { picture } = this, track = picture.rows.find((t) => t.id === this.followed);
    this.scale = Math.min(this.width, this.height) / (2 * this.half);
    this.x0 = track ? track.x : 0;
    this.y0 = track ? track.y : 0;
    this.up = this.riderUp ? picture.ego[2] : Math.PI / 2;
    this.cos = Math.cos(this.up);
    this.sin = Math.sin(this.up);
  }

  at(x, y) {
    const dx = x - this.x0, dy = y - this.y0;
    return [
      this.width / 2 + (dx * this.sin - dy * this.cos) * this.scale,
      this.height / 2 - (dx * this.cos + dy * this.sin) * this.scale,
    ];
  }

  turned(angle) { // of the fixed frame, as the canvas turns
    return this.up - angle - Math.PI / 2;
  }

  dots(p, size, dx = 0, dy = 0) {
    const { c } = this, half = size / 2;
    const a = this.sin * this.scale, b = this.cos * this.scale;
    const u = this.width / 2 - half - (this.x0 - dx) * a + (this.y0 - dy) * b;
    const v = this.height / 2 - half + (this.x0 - dx) * b + (this.y0 - dy) * a;
    c.beginPath();
    for (let i = 0; i < p.length; i += 2) {
      const x = u + p[i] * a - p[i + 1] * b, y = v - p[i] * b - p[i + 1] * a;
      if (x > -size && y > -size && x < this.width && y < this.height) c.rect(x, y, size, size);
    }
    c.fill();
  }

  rings() {
    const { c, look } = this, [x, y] = this.at(0, 0);
    const step = RING_M.find((m) => m >= this.half / 3.2) ?? 100;
    const reach = Math.hypot(this.width, this.height) / this.scale + Math.hypot(this.x0, this.y0);
    c.lineWidth = 1;
    c.strokeStyle = look.line;
    c.fillStyle = look.soft;
    c.font = `600 13px ${this.font}`;
    c.textAlign = "left";
    c.textBaseline = "bottom";
    for (let r = step; r < reach && r < 12 * step; r += step) {
      c.beginPath();
      c.arc(x, y, r * this.scale, 0, TAU);
      c.stroke();
      const d = r * this.scale * Math.SQRT1_2;
      c.fillText(`${r} m`, x + d + 2, y + d);
    }
  }

  standing() {
    if (!this.background) return;
    const { ego } = this.picture, { points, origin } = this.background;
    this.c.fillStyle = this.look.wall;
    this.dots(points, 2, origin[0] - ego[0], origin[1] - ego[1]);
  }

  points() {
    this.c.fillStyle = this.look.point;
    this.dots(this.picture.points, Math.min(Math.max(0.16 * this.scale, 2.5), 5));
  }

  // The lane the rider sweeps, ahead and behind, within which others are heard.
  lane() {
    const { c, look, setup } = this, [, , yaw, vx, vy, rate] = this.picture.ego;
    const speed = Math.hypot(vx, vy), [length, , centre] = setup.rider, half = setup.corridor / 2;
    const moving = speed > STANDING, course = moving ? Math.atan2(vy, vx) : yaw;
    const bend = moving ? Math.min(Math.max(rate / speed, -1 / length), 1 / length) : 0;
    const reach = Math.min(setup.horizon * Math.max(speed, 6), Math.abs(bend) > 1e-6 ? 2.8 / Math.abs(bend) : 1e9);
    const x0 = centre * Math.cos(yaw), y0 = centre * Math.sin(yaw);
    const edge = (side, from, to) => {
      for (let k = 0; k <= 24; k++) {
        const s = from + (to - from) * k / 24, turn = bend * s;
        const way = Math.abs(turn) < 1e-9 ? s : s * Math.sin(turn / 2) / (turn / 2);
        const x = x0 + way * Math.cos(course + turn / 2) - side * half * Math.sin(course + turn);
        const y = y0 + way * Math.sin(course + turn / 2) + side * half * Math.cos(course + turn);
        c.lineTo(...this.at(x, y));
      }
    };
    c.beginPath();
    edge(1, -reach, reach);
    edge(-1, reach, -reach);
    c.closePath();
    c.fillStyle = look.lane;
    c.fill();
    c.strokeStyle = look.line;
    c.lineWidth = 1.5;
    c.stroke();
  }

  rider() {
    const { c, look, picture, setup } = this, [length, width, centre] = setup.rider, yaw = picture.ego[2];
    const [x, y] = this.at(centre * Math.cos(yaw), centre * Math.sin(yaw));
    const l = Math.max(length * this.scale, 24), w = Math.max(width * this.scale, 12);
    c.save();
    c.translate(x, y);
    c.rotate(this.turned(yaw));
    c.beginPath();
    c.moveTo(l / 2 + w * 0.35, 0);
    c.lineTo(l / 2 - w * 0.3, w / 2);
    c.lineTo(-l / 2, w / 2);
    c.lineTo(-l / 2, -w / 2);
    c.lineTo(l / 2 - w * 0.3, -w / 2);
    c.closePath();
    c.fillStyle = look.ink;
    c.fill();
    c.lineWidth = 2;
    c.strokeStyle = look.ground;
    c.stroke();
    c.restore();
  }

  warned(track) { // colour of the alert that is about this track
    return track.id === this.picture.track && this.picture.level ? this.look[LEVELS[this.picture.level]] : null;
  }

  box(track) {
    const { c, look } = this, [x, y] = this.at(track.x, track.y);
    const l = Math.max(track.length * this.scale, 4), w = Math.max(track.width * this.scale, 4);
    const alarm = this.warned(track), state = STATES[track.state];
    c.save();
    c.translate(x, y);
    c.rotate(this.turned(track.yaw));
    c.setLineDash(state === "coasting" || state === "tentative" ? [5, 4] : []);
    c.fillStyle = alarm ?? look[state];
    c.globalAlpha = alarm ? 0.95 : state === "confirmed" ? 0.55 : state === "coasting" ? 0.35 : 0.12;
    c.fillRect(-l / 2, -w / 2, l, w);
    c.globalAlpha = 1;
    c.strokeStyle = alarm ? look.ink : look[state];
    c.lineWidth = alarm ? 3 : state === "static" ? 1 : 2;
    c.strokeRect(-l / 2, -w / 2, l, w);
    if (track.id === this.followed) {
      c.setLineDash([]);
      c.lineWidth = 2;
      c.strokeStyle = look.ink;
      c.strokeRect(-l / 2 - 5, -w / 2 - 5, l + 10, w + 10);
    }
    c.restore();
  }

  arrow(track) {
    const { c, look } = this, speed = Math.abs(track.speed);
    if (speed < 0.3) return;
    const way = track.speed * this.scale, [x, y] = this.at(track.x, track.y), head = 9 * Math.sign(way);
    c.save();
    c.translate(x, y);
    c.rotate(this.turned(track.course));
    for (const [colour, width] of [[look.ground, 6], [this.warned(track) ? look.ink : look[STATES[track.state]], 3]]) {
      c.strokeStyle = c.fillStyle = colour;
      c.lineWidth = width;
      c.beginPath();
      c.moveTo(0, 0);
      c.lineTo(way - head, 0);
      c.stroke();
      c.beginPath();
      c.moveTo(way + (width > 4 ? 2 * Math.sign(way) : 0), 0);
      c.lineTo(way - head, width > 4 ? 7 : 5.5);
      c.lineTo(way - head, width > 4 ? -7 : -5.5);
      c.fill();
    }
    c.restore();
  }

  arc(track) {
    const { c, look, picture } = this;
    c.beginPath();
    for (let k = 0; k < picture.steps; k++)
      c.lineTo(...this.at(picture.arcs[track.arc + 4 * k], picture.arcs[track.arc + 4 * k + 1]));
    c.setLineDash([2, 5]);
    c.lineCap = "round";
    c.lineWidth = this.warned(track) || track.id === this.followed ? 4 : 2.5;
    c.strokeStyle = this.warned(track) ?? look[STATES[track.state]];
    c.stroke();
    c.setLineDash([]);
    c.lineCap = "butt";
  }

  // Where the body surely is: its box, grown by the bound; of the followed or alerting one also what is to come.
  bound(track) {
    if (!Number.isFinite(track.bound_position) || !(moves(track) || track.id === this.followed)) return;
    const { c, picture, setup } = this, area = new Path2D();
    const chosen = track.id === this.followed || this.warned(track);
    const step = setup.arc[1], steps = chosen && moves(track) ? 1 + Math.round(BOUND_S / step) : 1;
    for (let k = 0; k < steps; k++) {
      const [x, y, yaw, told] = picture.arcs.subarray(track.arc + 4 * k, track.arc + 4 * k + 4);
      const off = k ? told : track.bound_position;
      if (Number.isFinite(off)) this.grow(area, x, y, yaw, track, off);
    }
    c.fillStyle = this.warned(track) ?? this.look[STATES[track.state]];
    c.globalAlpha = 0.22;
    c.fill(area);
    c.globalAlpha = 1;
  }

  grow(area, x, y, yaw, track, off) {
    const one = new Path2D(), l = (track.length + 2 * off) * this.scale, w = (track.width + 2 * off) * this.scale;
    one.roundRect(-l / 2, -w / 2, l, w, off * this.scale);
    const angle = this.turned(yaw), [u, v] = this.at(x, y);
    area.addPath(one, new DOMMatrix([Math.cos(angle), Math.sin(angle), -Math.sin(angle), Math.cos(angle), u, v]));
  }

  // Who it is, how fast, how long until contact; the important first, and none over another.
  labels(tracks) {
    const { c, look } = this;
    const weight = (t) => (this.warned(t) ? -2 : t.id === this.followed ? -1 : Math.min(t.ttc, 1e3));
    const told = tracks.filter((t) => (moves(t) && t.state !== 0) || t.id === this.followed);
    const bodies = [{ x: 0, y: 0 }, ...told].map((t) => this.at(t.x, t.y)); // the rider, too
    const taken = [...bodies.map(([x, y]) => [x - 12, y - 12, 24, 24]), [this.width - 60, 0, 60, 114]]; // buttons
    c.textBaseline = "middle";
    c.textAlign = "left";
    for (const track of told.sort((a, b) => weight(a) - weight(b))) {
      const big = weight(track) < 0;
      c.font = `${big ? 800 : 600} ${big ? 18 : 14}px ${this.font}`;
      const seconds = Number.isFinite(track.ttc) ? `  ${track.ttc.toFixed(1)} s` : "";
      const text = `${track.id}  ${Math.abs(track.speed).toFixed(0)} m/s${seconds}`;
      const width = c.measureText(text).width + 10, height = big ? 26 : 20;
      const [x, y] = this.at(track.x, track.y);
      const out = x < -20 || y < -20 || x > this.width + 20 || y > this.height + 20;
      if (out && !big) continue; // the one that matters is told at the edge
      const gap = Math.max(track.width * this.scale / 2, 6) + height / 2 + 4;
      const right = [x + gap, y - height / 2], left = [x - gap - width, y - height / 2];
      const toRight = Math.sin(this.up - track.course) * track.speed > 0; // the label goes where the body was
      const up = y - gap - height, down = y + gap;
      const spots = [toRight ? left : right, [x - width / 2, up], [x - width / 2, down], toRight ? right : left,
        [x + 8, down], [x + 8, up], [x - 8 - width, down], [x - 8 - width, up]]
        .map(([u, v]) => [this.inside(u, this.width - width), this.inside(v, this.height - height)]);
      const free = ([u, v]) => taken.every(([a, b, w, h]) => u >= a + w || a >= u + width || v >= b + h || b >= v + height);
      const spot = spots.find(free) ?? (big ? spots[1] : null);
      if (!spot) continue;
      taken.push([...spot, width, height]);
      const alarm = this.warned(track);
      c.fillStyle = alarm ?? look.halo;
      c.fillRect(...spot, width, height);
      if (alarm) {
        c.strokeStyle = look.ink;
        c.lineWidth = 2;
        c.strokeRect(...spot, width, height);
      }
      c.fillStyle = alarm ? "#000" : look.ink;
      c.fillText(text, spot[0] + 5, spot[1] + height / 2 + 1);
    }
  }

  inside(value, most) {
    return Math.min(Math.max(value, 2), Math.max(most - 2, 2));
  }

  // A tap picks a track, two fingers or the wheel zoom.
  touch(picked) {
    const { canvas } = this, fingers = new Map();
    let spread = 0, moved = false;
    const span = () => {
      const [a, b] = [...fingers.values()];
      return Math.hypot(a.x - b.x, a.y - b.y);
    };
    canvas.addEventListener("pointerdown", (e) => {
      fingers.set(e.pointerId, { x: e.clientX, y: e.clientY });
      if (fingers.size === 1) moved = false;
      if (fingers.size === 2) spread = span();
    });
    canvas.addEventListener("pointermove", (e) => {
      const finger = fingers.get(e.pointerId);
      if (!finger) return;
      if (Math.hypot(e.clientX - finger.x, e.clientY - finger.y) > 10) moved = true;
      if (fingers.size !== 2) return;
      fingers.set(e.pointerId, { x: e.clientX, y: e.clientY });
      this.zoom(spread / Math.max(span(), 1));
      spread = span();
    });
    const up = (e) => {
      if (fingers.delete(e.pointerId) && e.type === "pointerup" && !moved && !fingers.size) picked(this.pick(e));
    };
    for (const type of ["pointerup", "pointercancel", "pointerleave"]) canvas.addEventListener(type, up);
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      this.zoom(Math.exp(Math.sign(e.deltaY) * 0.12));
    }, { passive: false });
  }

  pick(event) {
    if (!this.picture) return null;
    const box = this.canvas.getBoundingClientRect();
    const x = event.clientX - box.left, y = event.clientY - box.top;
    let best = null, least = Math.max(TAP_M * this.scale, 22);
    for (const track of this.picture.rows) {
      const [u, v] = this.at(track.x, track.y);
      const gap = Math.hypot(u - x, v - y) - (track.length * this.scale) / 2;
      const cost = moves(track) ? gap : gap + 15;
      if (cost < least) [best, least] = [track.id, cost];
    }
    return best;
  }
}
