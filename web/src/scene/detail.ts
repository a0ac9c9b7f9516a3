// Level of detail: reduced by a step when frames are slow, raised by a step after a long time of fast frames.

export const LEVELS = ["full", "layered", "least"] as const;
export type DetailLevel = (typeof LEVELS)[number];

/** Settings of a level; resolutions are the maximum of device pixels per CSS pixel. */
export interface Detail {
  /** whether the static part of the scene is drawn once and cached */
  layered: boolean;
  /** resolutions of the whole scene, of its cached static part, and of the moving part */
  whole: number;
  backdrop: number;
  moving: number;
  /** minimum interval between redraws of the plots [ms] */
  plotInterval: number;
}

export const DETAIL: Record<DetailLevel, Detail> = {
  full: { layered: false, whole: 2, backdrop: 2, moving: 2, plotInterval: 66 },
  layered: { layered: true, whole: 1, backdrop: 1, moving: 1, plotInterval: 100 },
  least: { layered: true, whole: 0.6, backdrop: 1, moving: 0.6, plotInterval: 250 },
};

const SLOW_FRAME_MS = 40; // fewer than 25 frames per second
const FAST_FRAME_MS = 20; // close to the refresh interval of most screens
const SLOW_WINDOW_FRAMES = 24; // frames considered before the level is reduced
const FAST_WINDOW_FRAMES = 240; // and before it is raised
const FAST_FRACTION = 0.9; // of these frames must be fast
const MIN_LEVEL_TIME_MS = 5000; // before the level is raised; doubled each time that the higher level was too slow
const MAX_LEVEL_TIME_MS = 320_000;
const IDLE_GAP_MS = 500; // longer gaps are idle time, not slow drawing

/** Level requested in the page's address (`?detail=full`); null: none. */
export function requestedLevel(): DetailLevel | null {
  const word = new URLSearchParams(location.search).get("detail");
  return LEVELS.find((level) => level === word) ?? null;
}

export class DetailControl {
  private at: number;
  private frameTimes: number[] = [];
  private last = -Infinity;
  private changedAt = 0;
  private raisedAt = -Infinity;
  private levelTime = MIN_LEVEL_TIME_MS;

  /** `best`: the initial and highest level; `fixed`: never change it. */
  constructor(
    readonly best: DetailLevel,
    private readonly fixed: boolean,
  ) {
    this.at = LEVELS.indexOf(best);
  }

  get level(): DetailLevel {
    return LEVELS[this.at]!;
  }

  /** Register a frame drawn at time `now` [ms]; returns whether the level changed. */
  frame(now: number): boolean {
    const frameTime = now - this.last;
    this.last = now;
    if (this.fixed || !(frameTime < IDLE_GAP_MS)) return false;
    this.frameTimes.push(frameTime);
    if (this.frameTimes.length > FAST_WINDOW_FRAMES) this.frameTimes.shift();
    const slow = this.frameTimes.slice(-SLOW_WINDOW_FRAMES).filter((ms) => ms > SLOW_FRAME_MS).length;
    if (slow > SLOW_WINDOW_FRAMES / 2 && this.at < LEVELS.length - 1) {
      // Back off after a failed attempt: switching back and forth between levels is worse than either.
      if (now - this.raisedAt < this.levelTime) this.levelTime = Math.min(MAX_LEVEL_TIME_MS, 2 * this.levelTime);
      return this.step(1, now);
    }
    const fast = this.frameTimes.filter((ms) => ms < FAST_FRAME_MS).length;
    if (this.at > LEVELS.indexOf(this.best) && fast >= FAST_FRACTION * FAST_WINDOW_FRAMES && now - this.changedAt > this.levelTime) {
      this.raisedAt = now;
      return this.step(-1, now);
    }
    return false;
  }

  private step(by: number, now: number): boolean {
    this.at += by;
    this.changedAt = now;
    this.frameTimes = [];
    return true;
  }
}
