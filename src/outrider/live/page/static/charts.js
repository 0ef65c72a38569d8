// Speed and time to collision of one track against time, as two strips.

import uPlot from "./vendor/uPlot.esm.js";
import { LEVELS } from "./message.js";

const HEIGHT = 120, TOP_S = 8; // of the time axis of time to collision

export class Charts {
  constructor(speeds, times, ladder) {
    this.hosts = [speeds, times];
    this.ladder = ladder;
    this.now = null; // seconds, where the picture is
    this.range = [-60, 0];
    this.speeds = [0, 5]; // m/s, by the estimate alone: a bound may be very wide at first
    this.build();
    new ResizeObserver(() => this.fit()).observe(speeds);
  }

  build() {
    this.plots?.forEach((plot) => plot.destroy());
    const style = getComputedStyle(document.documentElement);
    const read = (name) => style.getPropertyValue(`--${name}`).trim();
    const [ink, line, own] = ["soft", "line", "confirmed"].map(read);
    this.colours = { ink: read("ink"), levels: LEVELS.map(read) };
    const axis = { stroke: ink, grid: { stroke: line, width: 1 }, ticks: { show: false }, font: `12px ${read("font")}` };
    const thick = (label, more = {}) => ({ label, stroke: own, width: 2.5, points: { show: false }, spanGaps: false, ...more });
    const thin = (label) => thick(label, { width: 0 });
    const make = (host, label, y, draw) => new uPlot({
      width: host.clientWidth || 300,
      height: HEIGHT,
      legend: { show: false },
      cursor: { show: false },
      padding: [6, 8, 0, 0],
      scales: { x: { time: false, range: () => this.range }, y: { range: y } },
      axes: [{ ...axis, values: (_, v) => v.map((t) => `${t} s`), space: 60, size: 26 }, { ...axis, size: 34, space: 28 }],
      series: [{}, thick(label), thin("least"), thin("most")],
      bands: [{ series: [3, 2], fill: own + "33" }],
      hooks: { draw: [draw, (plot) => this.cursor(plot)] },
    }, [[], [], [], []], host);
    this.plots = [
      make(this.hosts[0], "speed", () => this.speeds, () => {}),
      make(this.hosts[1], "time to collision", () => [0, TOP_S], (plot) => this.thresholds(plot)),
    ];
    if (this.data) this.set(this.data);
  }

  fit() {
    this.plots.forEach((plot, i) => plot.setSize({ width: this.hosts[i].clientWidth, height: HEIGHT }));
  }

  // series: columns of times.js; null: no track.
  set(series, now = this.now, range = this.range) {
    Object.assign(this, { data: series, now, range });
    const none = [[], [], [], []];
    const finite = (v) => (v !== null && Number.isFinite(v) ? v : null);
    const short = (v) => (finite(v) === null || v > TOP_S ? null : v);
    if (!series) return this.plots.forEach((plot) => plot.setData(none));
    const { t, speed, off, ttc, earliest, latest } = series, known = speed.filter((v) => finite(v) !== null);
    this.speeds = [Math.min(0, ...known), 1.25 * Math.max(4, ...known)];
    const bounded = t.map((_, i) => finite(off[i]) !== null && speed[i] !== null);
    const band = (i, v) => (bounded[i] ? v : null);
    this.plots[0].setData([t, speed, t.map((_, i) => band(i, speed[i] - off[i])), t.map((_, i) => band(i, speed[i] + off[i]))]);
    const near = t.map((_, i) => bounded[i] && short(earliest[i]) !== null);
    this.plots[1].setData([t, ttc.map(short), t.map((_, i) => (near[i] ? earliest[i] : null)),
      t.map((_, i) => (near[i] ? Math.min(finite(latest[i]) ?? TOP_S, TOP_S) : null))]);
    return undefined;
  }

  thresholds(plot) {
    const { ctx } = plot, { left, width } = plot.bbox;
    this.ladder.forEach((seconds, i) => {
      const y = plot.valToPos(seconds, "y", true);
      ctx.save();
      for (const [colour, thick] of [[this.colours.ink, 2], [this.colours.levels[i + 1], 1]]) {
        ctx.strokeStyle = colour;
        ctx.lineWidth = (thick + i / 2) * devicePixelRatio;
        ctx.beginPath();
        ctx.moveTo(left, y);
        ctx.lineTo(left + width, y);
        ctx.stroke();
      }
      ctx.restore();
    });
  }

  cursor(plot) {
    if (this.now === null) return;
    const x = plot.valToPos(this.now, "x", true), { top, height } = plot.bbox;
    plot.ctx.save();
    plot.ctx.strokeStyle = this.colours.ink;
    plot.ctx.lineWidth = 2 * devicePixelRatio;
    plot.ctx.beginPath();
    plot.ctx.moveTo(x, top);
    plot.ctx.lineTo(x, top + height);
    plot.ctx.stroke();
    plot.ctx.restore();
  }
}
