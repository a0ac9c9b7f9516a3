// Playback clock: time, speed, and looped range.

export const SPEEDS = [0.02, 0.05, 0.1, 0.25, 0.5, 1, 2, 4, 8, 16] as const;

export class Clock {
  /** time on the timeline, zero at the first tick of the first recording [s] */
  time = 0;
  playing = false;
  speed = 1;
  loop = false;
  range: { from: number; to: number } | null = null;

  /** `begin` and `end` of the timeline [s] */
  constructor(
    public begin: number,
    public end: number,
  ) {}

  get loopRange(): { from: number; to: number } {
    return this.range ?? { from: this.begin, to: this.end };
  }

  go(time: number): void {
    this.time = Math.min(Math.max(time, this.begin), this.end);
  }

  play(yes: boolean): void {
    this.playing = yes;
    // At the end, start again from the beginning.
    if (yes && this.time >= (this.loop ? this.loopRange.to : this.end) - 1e-6) this.time = this.loop ? this.loopRange.from : this.begin;
  }

  /** Advance by `seconds` of real time. */
  advance(seconds: number): void {
    if (!this.playing) return;
    const before = this.time;
    this.time += seconds * this.speed;
    const { from, to } = this.loopRange;
    if (this.loop && before <= to && this.time > to) this.time = to > from ? from + ((this.time - from) % (to - from)) : from;
    else if (this.time >= this.end) {
      this.time = this.end;
      this.playing = false;
    }
  }

  faster(steps: number): void {
    const now = SPEEDS.findIndex((speed) => speed >= this.speed);
    this.speed = SPEEDS[Math.min(Math.max(now + steps, 0), SPEEDS.length - 1)]!;
  }

  /** Set the start or end of the loop to the present time. */
  mark(end: "from" | "to"): void {
    const { from, to } = this.loopRange;
    if (end === "from") this.range = { from: this.time, to: to > this.time ? to : this.end };
    else this.range = { from: from < this.time ? from : this.begin, to: this.time };
    this.loop = true;
  }
}

/** Format a time as h:mm:ss, such as 1:02:03.456. */
export function formatTime(seconds: number, digits = 3): string {
  const size = Math.abs(seconds);
  const [h, m, s] = [Math.floor(size / 3600), Math.floor((size % 3600) / 60), size % 60];
  const two = (value: string): string => (value.indexOf(".") === 1 || value.length === 1 ? `0${value}` : value);
  const tail = size < 60 ? `${s.toFixed(digits)} s` : `${h ? `${h}:${two(String(m))}` : m}:${two(s.toFixed(digits))}`;
  return `${seconds < 0 ? "−" : ""}${tail}`;
}
