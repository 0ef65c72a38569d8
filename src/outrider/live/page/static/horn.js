// Two tones by alert level; a browser lets a page sound only after a tap, so it begins silent.

const LOW = 420, HIGH = 530, LOST = 220; // Hz
const PATTERNS = { // [start, length, loudness, tones]... and seconds until it is played again
  notice: { beeps: [[0, 0.12, 0.25, [LOW]]], every: Infinity },
  caution: { beeps: [[0, 0.14, 0.5, [LOW, HIGH]], [0.22, 0.14, 0.5, [LOW, HIGH]]], every: 1.2 },
  danger: { beeps: [[0, 0.3, 1, [LOW, HIGH]]], every: 0.38 },
  lost: { beeps: [[0, 0.35, 0.5, [LOST]], [0.45, 0.5, 0.5, [LOST * 0.75]]], every: Infinity },
};

export class Horn {
  constructor() {
    this.context = null;
    this.on = false;
    this.pattern = null;
    this.next = 0;
    this.played = 0; // beeps so far
  }

  async toggle() {
    this.on = !this.on;
    if (this.on) {
      this.context ??= new AudioContext();
      await this.context.resume();
      this.beep(0, 0.08, 0.2, [HIGH]); // so that the rider hears that it can be heard
    }
    return this.on;
  }

  // Ten times a second: what should sound now, by name of its pattern, null for nothing.
  sound(name) {
    const changed = name !== this.pattern;
    this.pattern = name;
    if (!this.on || !PATTERNS[name]) return;
    const now = this.context.currentTime, { beeps, every } = PATTERNS[name];
    if (!changed && now < this.next) return;
    this.next = now + every;
    for (const beep of beeps) this.beep(...beep);
  }

  beep(start, length, loudness, tones) {
    const begin = this.context.currentTime + start, gain = this.context.createGain();
    gain.gain.setValueAtTime(0, begin);
    gain.gain.linearRampToValueAtTime(loudness / tones.length, begin + 0.01);
    gain.gain.setValueAtTime(loudness / tones.length, begin + length - 0.02);
    gain.gain.linearRampToValueAtTime(0, begin + length);
    gain.connect(this.context.destination);
    for (const tone of tones) {
      const source = this.context.createOscillator();
      source.type = "sawtooth";
      source.frequency.value = tone;
      source.connect(gain);
      source.start(begin);
      source.stop(begin + length);
    }
    this.played += 1;
  }
}
