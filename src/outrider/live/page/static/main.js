// Wires the parts: what comes over the link goes to the ring, what is looked at to scene, banner and charts.

import { Banner } from "./banner.js";
import { Charts } from "./charts.js";
import { Controls } from "./controls.js";
import { Horn } from "./horn.js";
import { Link } from "./link.js";
import { LEVELS, moves, unpack } from "./message.js";
import { Scene } from "./scene.js";
import { Ring, RunTimes } from "./times.js";

const $ = (id) => document.getElementById(id);
const WATCH_MS = 100, CHARTS_MS = 250;
const LAG_S = 0.5; // a connection slower than this is told
const SILENT_S = 1.5; // without a word from the server the connection counts as lost
const HUNG_S = 1.5; // a page that does not run for so long hides its banner

class Page {
  constructor() {
    this.setup = null; // what the server said first
    this.source = new Ring();
    this.newest = this.shown = null; // pictures
    this.paused = false;
    this.followed = this.subject = null; // track: in the middle of the view; in the charts
    this.beat = { age: 0, lag: 0, degraded: [], counts: {} };
    this.beaten = performance.now();
    this.arrivals = [];
    this.dropped = 0;
    this.banner = new Banner();
    this.horn = new Horn();
    this.scene = new Scene($("scene"), (id) => this.follow(id));
    this.controls = new Controls(this);
    this.controls.paint();
    this.link = new Link({
      hello: (hello) => this.hello(hello),
      picture: (buffer) => this.took(buffer),
      beat: (beat) => Object.assign(this, { beat, beaten: performance.now() }),
      changed: () => this.watch(),
    }, (why) => this.controls.gate(why));
    this.hung = dies($("hung"), HUNG_S);
    setInterval(() => this.watch(), WATCH_MS);
    setInterval(() => this.chart(), CHARTS_MS);
  }

  get isRun() { return this.setup?.mode === "run"; }

  async hello(hello) {
    this.setup = hello;
    document.documentElement.dataset.mode = hello.mode;
    this.charts ??= new Charts($("speeds"), $("times"), hello.ladder);
    this.old = dies($("deadman"), 2 * hello.stale);
    this.old.cancel();
    if (!this.isRun || this.source instanceof RunTimes) return;
    this.source = new RunTimes(this.link, hello.run);
    this.paused = true;
    this.controls.ready();
    this.source.ask(0);
    const answer = await fetch("data/background");
    if (answer.ok) this.scene.background = { points: new Float32Array(await answer.arrayBuffer()), origin: hello.run.origin };
    this.scene.draw();
  }

  took(buffer) {
    const picture = unpack(buffer, this.setup.columns), before = this.newest;
    picture.at = performance.now() / 1000;
    this.arrivals.push(picture.at);
    this.newest = picture;
    if (this.isRun) {
      this.source.answered();
      return this.show(picture);
    }
    if (before && picture.number <= before.number) this.source = new Ring(); // outrider was started anew
    else if (before && this.link.state === "open") this.dropped += picture.number - before.number - 1;
    this.source.push(picture, this.paused);
    if (!this.paused) {
      revive(this.old);
      this.show(picture);
    }
    return this.watch();
  }

  show(picture) {
    this.shown = picture;
    if (this.pending) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      this.scene.show(this.shown, this.setup, this.followed);
      $("scene").dataset.number = this.shown.number;
      if (this.isRun) this.banner.alert(this.shown, this.shown.degraded.length > 0);
      this.controls.update();
    });
  }

  // Ten times a second, whatever comes or does not: how far what is seen can be trusted.
  watch() {
    revive(this.hung);
    const dead = this.dead(), reasons = this.reasons(dead);
    this.isDead = dead !== null;
    document.documentElement.dataset.trust = dead ? "dead" : reasons.length ? "degraded" : "good";
    if (dead && !this.paused) this.old?.finish();
    if (dead) this.banner.dead(...dead);
    else if (!this.isRun) this.banner.alert(this.newest, reasons.length > 0);
    this.banner.trust(reasons);
    this.horn.sound(this.pattern(dead));
    if (this.setup && !this.pending) this.controls.update();
  }

  // Title and reason where nothing can be said about now; null where something can.
  dead() {
    const { link } = this, lost = link.silence, ago = `for ${Math.max(lost, 0).toFixed(0)} s`;
    if (link.state === "token") return ["locked", "enter the token that outrider printed"];
    if (link.state === "full") return ["not shown", link.reason];
    if (link.state === "ended") return ["ended", link.reason];
    if (link.state === "lost" || (link.state === "open" && !this.isRun && lost > SILENT_S))
      return ["no connection", `${ago}: is outrider running, is the network there?`];
    if (link.state !== "open" || !this.newest) return ["waiting", "no picture yet"];
    if (!this.isRun && this.age > 2 * this.setup.stale) return ["no scans", `for ${this.age.toFixed(1)} s`];
    return null;
  }

  // Seconds since the newest scan was ready: as this page saw it, or as the server says.
  get age() {
    const now = performance.now(), told = this.beat.age === null ? 0 : this.beat.age + (now - this.beaten) / 1000;
    const seen = this.newest ? now / 1000 - this.newest.at : 0;
    return Math.min(seen, told) > 0.3 ? Math.max(seen, told) : seen;
  }

  reasons(dead) {
    const picture = this.isRun ? this.shown : this.newest;
    const reasons = new Set([...(picture?.degraded ?? []), ...(this.isRun ? [] : this.beat.degraded)]);
    if (dead) return [...reasons];
    const { lag } = this.beat;
    if (!this.isRun && lag > LAG_S) reasons.add(`slow connection: the picture is up to ${lag.toFixed(1)} s late`);
    return [...reasons];
  }

  pattern(dead) {
    if (this.isRun) return this.controls.playing && this.shown ? LEVELS[this.shown.level] : null;
    return dead ? (this.newest ? "lost" : null) : LEVELS[this.newest.level];
  }

  follow(id) {
    this.followed = id;
    this.redraw();
    this.controls.choices(true);
    this.chart();
  }

  redraw() {
    if (this.shown) this.show(this.shown);
  }

  pause(yes) {
    this.paused = yes;
    if (yes) this.old?.cancel();
    else if (!this.isRun && this.newest) {
      revive(this.old);
      this.show(this.newest);
    }
    this.controls.update();
  }

  // What the charts are about: the followed track, else the one last warned of, else the one soonest here.
  choose() {
    const { rows } = this.shown, has = (id) => rows.some((t) => t.id === id);
    if (this.followed !== null) return this.followed;
    if (this.shown.level && has(this.shown.track)) return this.shown.track;
    if (has(this.subject)) return this.subject;
    const near = rows.filter(moves).sort((a, b) => a.ttc - b.ttc || Math.hypot(a.x, a.y) - Math.hypot(b.x, b.y));
    return near[0]?.id ?? null;
  }

  async chart() {
    if (!this.shown) return;
    this.controls.slow();
    const id = this.subject = this.choose(), { source } = this;
    const series = id === null ? null : await source.series(id);
    if (id !== this.subject || !this.shown) return;
    const why = id === this.followed ? ", followed" : this.shown.level && id === this.shown.track ? ", warned of" : "";
    $("subject").textContent = id === null ? "No track" : `Track ${id}${why}`;
    const now = source.ago(this.shown);
    const range = this.isRun ? [0, Math.max(source.t[source.length - 1] - source.t[0], 1)] : this.paused ? [-60, 0] : [-20, 0];
    this.charts.set(series, this.isRun || this.paused ? now : null, range);
  }

  theme() {
    this.scene.colours();
    this.scene.draw();
    this.charts?.build();
    this.controls.marks();
  }
}

// A cover over an element that appears by itself, unless it is revived in time: it needs no script to do so.
function dies(element, seconds) {
  const frames = [{ opacity: 0 }, { opacity: 0, offset: 0.99 }, { opacity: 1 }];
  return element.animate(frames, { duration: 1000 * seconds, fill: "forwards" });
}

function revive(animation) {
  if (!animation) return;
  animation.currentTime = 0;
  animation.play();
}

window.page = new Page(); // for the console
