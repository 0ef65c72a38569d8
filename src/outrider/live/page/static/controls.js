// Buttons, keys, the slider and the numbers; what they do is done by the page.

import { moves } from "./message.js";

const $ = (id) => document.getElementById(id);
const THEMES = ["auto", "light", "dark"];
const THUMB_PX = 22; // of the slider, as in style.css

export class Controls {
  constructor(page) {
    this.page = page;
    this.playing = false;
    this.known = "";
    this.buttons();
    document.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.marks()).observe($("track"));
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.dark.addEventListener("change", () => this.paint());
    document.addEventListener("pointerdown", () => this.awake(), { once: true });
  }

  buttons() {
    const { page } = this;
    const on = (id, act) => $(id).addEventListener("click", act);
    on("back", () => this.step(-1));
    on("on", () => this.step(1));
    on("pause", () => this.toggle());
    on("nearer", () => page.scene.zoom(0.8));
    on("farther", () => page.scene.zoom(1.25));
    on("turn", () => this.turn());
    on("horn", () => this.horn());
    on("theme", () => this.nextTheme());
    on("help", () => $("keys").showModal());
    $("slider").addEventListener("input", () => this.go(Number($("slider").value)));
    $("follow").addEventListener("change", () => page.follow($("follow").value ? Number($("follow").value) : null));
    $("entry").addEventListener("submit", (event) => this.token(event));
    $("gate").addEventListener("cancel", (event) => event.preventDefault());
  }

  key(event) {
    const tag = event.target.tagName;
    if (event.ctrlKey || event.metaKey || event.altKey || $("keys").open || $("gate").open) return;
    if (tag === "SELECT" || (tag === "BUTTON" && event.key === " ")) return;
    if (tag === "INPUT" && event.key.startsWith("Arrow")) return; // the slider moves itself
    const act = {
      " ": () => this.toggle(), ArrowLeft: () => this.step(event.shiftKey ? -10 : -1),
      ArrowRight: () => this.step(event.shiftKey ? 10 : 1), End: () => this.newest(), Home: () => this.go(0),
      f: () => this.next(), Escape: () => this.page.follow(null), "+": () => this.page.scene.zoom(0.8),
      "=": () => this.page.scene.zoom(0.8), "-": () => this.page.scene.zoom(1.25), o: () => this.turn(),
      h: () => this.horn(), t: () => this.nextTheme(), "?": () => $("keys").showModal(),
    }[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act) return;
    event.preventDefault();
    act();
  }

  // ------------------------------------------------------------------ time

  get index() {
    const { page } = this;
    if (!page.shown) return 0;
    if (page.isRun) return page.source.wish ?? page.shown.number;
    return Math.max(page.source.index(page.shown), 0);
  }

  toggle() {
    const { page } = this;
    if (page.isRun) this.play(!this.playing);
    else page.pause(!page.paused);
  }

  step(by) {
    this.play(false);
    this.go(this.index + by);
  }

  go(index) {
    const { page } = this, { source } = page;
    if (page.isRun) {
      source.ask(index);
      this.head = source.clock[Math.max(0, Math.min(index, source.length - 1))];
    } else if (source.length) {
      page.pause(true);
      page.show(source.at(index));
    }
  }

  newest() {
    const { page } = this;
    if (page.isRun) this.go(page.source.length - 1);
    else page.pause(false);
  }

  play(yes) {
    const { page } = this, { source } = page;
    if (!page.isRun || yes === this.playing) return;
    this.playing = yes;
    this.update();
    if (!yes) return;
    this.head = this.index >= source.length - 1 ? 0 : source.clock[this.index];
    let before = performance.now();
    const tick = (now) => {
      if (!this.playing) return;
      this.head += Number($("speed").value) * Math.min(now - before, 250) / 1000;
      before = now;
      const index = source.find(this.head);
      if (index !== this.index) source.ask(index);
      if (index >= source.length - 1) this.play(false);
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  ready() {
    $("pace").hidden = false;
    const { source } = this.page;
    $("slider").max = source.length - 1;
    $("whole").textContent = `of ${(source.t[source.length - 1] - source.t[0]).toFixed(1)} s`;
    this.marks();
  }

  // Every picture: where the slider is, what the button does, whether it is the past.
  update() {
    const { page } = this, { source, shown } = page;
    if (!shown) return;
    const slider = $("slider"), ago = source.ago(shown);
    if (!page.isRun) slider.max = Math.max(source.length - 1, 0);
    if (page.isRun || document.activeElement !== slider || !page.paused) slider.value = this.index;
    const past = !page.isRun && page.paused;
    const clock = page.isRun || past ? `${ago.toFixed(1)} s` : page.isDead ? "old" : "now";
    text($("clock"), clock);
    slider.setAttribute("aria-valuetext", past ? `${(-ago).toFixed(1)} seconds ago` : clock);
    text($("pause"), page.isRun ? (this.playing ? "Pause" : "Play") : page.paused ? "Back to now" : "Pause");
    $("past").hidden = !past;
    text($("past"), past ? `PAST, ${(-ago).toFixed(1)} s ago; the banner is now` : "");
    $("view").classList.toggle("past", past);
    text($("status"), this.status());
  }

  status() {
    const { page } = this, now = performance.now() / 1000;
    page.arrivals = page.arrivals.filter((at) => now - at < 2);
    if (page.isRun) return page.setup.about.recording ?? "";
    return `${(page.arrivals.length / 2).toFixed(1)} Hz, ${page.dropped} dropped`;
  }

  // Coloured and higher the graver: where on the slider there were alerts.
  marks() {
    const canvas = $("marks"), levels = this.page.source?.levels() ?? [], ratio = window.devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight, c = canvas.getContext("2d");
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    c.scale(ratio, ratio);
    const { look } = this.page.scene, step = (width - THUMB_PX) / Math.max(levels.length - 1, 1);
    [look.notice, look.caution, look.danger].forEach((colour, k) => {
      c.fillStyle = colour;
      levels.forEach((level, i) => {
        const tall = height * (k + 1) / 3;
        if (level === k + 1) c.fillRect(THUMB_PX / 2 + (i - 0.5) * step, height - tall, Math.max(step, 2), tall);
      });
    });
  }

  // ------------------------------------------------------------------ the rest

  // Four times a second: what need not be at once.
  slow() {
    if (!this.page.isRun) this.marks();
    this.choices(false);
    this.numbers();
  }

  choices(force) {
    const { page } = this, select = $("follow");
    if (!page.shown || (document.activeElement === select && !force)) return;
    const ids = new Set(page.shown.rows.filter(moves).map((t) => t.id));
    if (page.followed !== null) ids.add(page.followed);
    const known = [...ids].sort((a, b) => a - b).join();
    if (known !== this.known) {
      this.known = known;
      select.replaceChildren(new Option("rider", ""), ...[...ids].sort((a, b) => a - b).map((id) => new Option(`track ${id}`, id)));
    }
    select.value = page.followed ?? "";
  }

  next() {
    const { page } = this;
    if (!page.shown) return;
    const ids = page.shown.rows.filter(moves).map((t) => t.id);
    page.follow(ids.find((id) => id > (page.followed ?? -1)) ?? null);
  }

  numbers() {
    const { page } = this, costs = [...page.scene.costs].sort((a, b) => a - b), { beat, setup, shown } = page;
    const seconds = (s) => `${(1000 * s).toFixed(0)} ms`;
    const told = {
      "last beam to picture ready": shown.late === undefined ? "–" : seconds(shown.late),
      "to this page and back": page.isRun ? "–" : seconds(beat.lag),
      "drawing, median": costs.length ? `${costs[costs.length >> 1].toFixed(1)} ms` : "–",
      returns: shown.points.length / 2,
      tracks: shown.id.length,
      "rider": shown.known ? `${Math.hypot(shown.ego[3], shown.ego[4]).toFixed(1)} m/s` : "no pose: taken as standing",
      ...setup.about,
      ...(page.isRun ? {} : beat.counts),
    };
    const parts = Object.entries(told).flatMap(([name, value]) => {
      const dt = document.createElement("dt"), dd = document.createElement("dd");
      dt.textContent = name;
      dd.textContent = value;
      return [dt, dd];
    });
    $("numbers").replaceChildren(...parts);
  }

  turn() {
    const { scene } = this.page;
    scene.riderUp = !scene.riderUp;
    $("turn").setAttribute("aria-pressed", scene.riderUp);
    scene.draw();
  }

  async horn() {
    const on = await this.page.horn.toggle();
    $("horn").textContent = on ? "Horn on" : "Horn: tap to start";
    $("horn").setAttribute("aria-pressed", on);
  }

  nextTheme() {
    const now = localStorage.getItem("theme") ?? "auto";
    localStorage.setItem("theme", THEMES[(THEMES.indexOf(now) + 1) % THEMES.length]);
    this.paint();
  }

  paint() {
    const chosen = localStorage.getItem("theme") ?? "auto";
    document.documentElement.dataset.theme = chosen === "auto" ? (this.dark.matches ? "dark" : "light") : chosen;
    $("theme").textContent = { auto: "◐ Auto", light: "○ Light", dark: "● Dark" }[chosen];
    this.page.theme();
  }

  gate(why) {
    $("refusal").textContent = why;
    if (!$("gate").open) $("gate").showModal();
  }

  async token(event) {
    event.preventDefault();
    if (await this.page.link.show($("token").value)) {
      $("gate").close();
      history.replaceState(null, "", location.pathname);
      this.page.link.enter();
    } else {
      $("refusal").textContent = "That token is not the right one.";
    }
  }

  // A screen that goes dark warns nobody; only over https or on this machine do browsers let a page ask.
  async awake() {
    const ask = () => navigator.wakeLock?.request("screen").catch(() => {});
    ask();
    document.addEventListener("visibilitychange", () => document.visibilityState === "visible" && ask());
  }
}

function text(element, words) {
  if (element.textContent !== words) element.textContent = words;
}
