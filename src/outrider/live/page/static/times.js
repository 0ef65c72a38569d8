// Pictures by index: the last minute of a live run, or all of a finished one.

export const KEEP_S = 60, KEEP_PAUSED_S = 180;

// What came in the last minute; longer while paused, so that what was to be looked at stays.
export class Ring {
  constructor() {
    this.pictures = [];
  }

  push(picture, paused) {
    const keep = paused ? KEEP_PAUSED_S : KEEP_S, list = this.pictures;
    list.push(picture);
    let old = 0;
    while (old < list.length - 1 && picture.at - list[old].at > keep) old++;
    if (old) list.splice(0, old);
  }

  get length() { return this.pictures.length; }
  get last() { return this.pictures[this.pictures.length - 1]; }
  at(i) { return this.pictures[Math.max(0, Math.min(i, this.length - 1))]; }
  index(picture) { return this.pictures.indexOf(picture); }
  levels() { return this.pictures.map((p) => p.level); }
  ago(picture) { return picture.at - this.last.at; } // seconds, negative

  // Columns of one track against seconds before the newest picture, as a chart wants them.
  async series(id) {
    const out = { t: [], speed: [], off: [], ttc: [], earliest: [], latest: [] };
    for (const picture of this.pictures) {
      const i = picture.id.indexOf(id);
      const track = i < 0 ? null : picture.rows[i];
      out.t.push(this.ago(picture));
      out.speed.push(track ? track.speed : null);
      out.off.push(track ? track.bound_speed : null);
      for (const name of ["ttc", "earliest", "latest"]) out[name].push(track ? track[name] : null);
    }
    return out;
  }
}

// A run folder: the server keeps the pictures, the newest wish is answered.
export class RunTimes {
  constructor(link, run) {
    this.link = link;
    this.t = run.t;
    this.clock = [0]; // seconds of playing; a clock that jumped back costs none
    for (let i = 1; i < run.t.length; i++) this.clock.push(this.clock[i - 1] + Math.max(run.t[i] - run.t[i - 1], 0));
    this.all = run.levels;
    this.waiting = false; // for an answer
    this.wish = null; // index wanted after that
    this.cache = new Map(); // series by track
  }

  get length() { return this.t.length; }
  levels() { return this.all; }
  ago(picture) { return this.t[picture.number] - this.t[0]; } // seconds from the start

  ask(i) {
    this.wish = Math.max(0, Math.min(i, this.length - 1));
    this.flush();
  }

  answered() {
    this.waiting = false;
    this.flush();
  }

  flush() {
    if (this.waiting || this.wish === null) return;
    this.waiting = true;
    this.link.want(this.wish);
    this.wish = null;
  }

  // Index of the picture after s seconds of playing.
  find(s) {
    let low = 0, high = this.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.clock[middle] <= s) low = middle; else high = middle - 1;
    }
    return low;
  }

  async series(id) {
    if (!this.cache.has(id)) {
      const answer = await fetch(`data/series?track=${id}`);
      this.cache.set(id, answer.ok ? await answer.json() : null);
    }
    return this.cache.get(id);
  }
}
