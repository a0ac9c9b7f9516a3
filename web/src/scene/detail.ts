// How much is drawn, in named levels: one down when frames come late, one up when they have long come in time.

export const LEVELS = ["full", "layered", "least"] as const;
export type Level = (typeof LEVELS)[number];

/** What a level draws; the sharpness is the most device pixels per CSS pixel. */
export interface Detail {
  /** whether what stands still is drawn once and kept */
  layered: boolean;
  /** sharpness of a picture of everything, of what is kept, and of what moves over it */
  whole: number;
  kept: number;
  moving: number;
  /** ms between two drawings of the plots */
  plots: number;
}

export const DETAIL: Record<Level, Detail> = {
  full: { layered: false, whole: 2, kept: 2, moving: 2, plots: 66 },
  layered: { layered: true, whole: 1, kept: 1, moving: 1, plots: 100 },
  least: { layered: true, whole: 0.6, kept: 1, moving: 0.6, plots: 250 },
};

const LATE = 40; // ms from frame to frame: fewer than 25 a second
const BRISK = 20; // ms: as fast as most screens
const FEW = 24; // frames that decide whether it is slow
const MANY = 240; // frames that decide whether it is quick
const PATIENCE = 5000; // ms at a level before a finer one is tried; doubled when that was too much
const MOST = 320_000;
const PAUSE = 500; // ms: nothing was drawn, which says nothing about speed

/** The level that the page's address asks for (`?detail=full`), if it does. */
export function requestedLevel(): Level | null {
  const word = new URLSearchParams(location.search).get("detail");
  return LEVELS.find((level) => level === word) ?? null;
}

export class DetailControl {
  private at: number;
  private paces: number[] = [];
  private last = -Infinity;
  private since = 0;
  private rose = -Infinity;
  private patience = PATIENCE;

  /** It begins at `best`, goes no finer, and stays there if it is `fixed`. */
  constructor(
    readonly best: Level,
    private readonly fixed: boolean,
  ) {
    this.at = LEVELS.indexOf(best);
  }

  get level(): Level {
    return LEVELS[this.at]!;
  }

  /** Something was drawn in the frame at `now` [ms]; true if the level is another one from here on. */
  frame(now: number): boolean {
    const pace = now - this.last;
    this.last = now;
    if (this.fixed || !(pace < PAUSE)) return false;
    this.paces.push(pace);
    if (this.paces.length > MANY) this.paces.shift();
    const late = this.paces.slice(-FEW).filter((ms) => ms > LATE).length;
    if (late > FEW / 2 && this.at < LEVELS.length - 1) {
      // What was tried and failed is not tried again soon: a picture that flickers between levels is worse than either.
      if (now - this.rose < this.patience) this.patience = Math.min(MOST, 2 * this.patience);
      return this.step(1, now);
    }
    const brisk = this.paces.filter((ms) => ms < BRISK).length;
    if (this.at > LEVELS.indexOf(this.best) && brisk >= 0.9 * MANY && now - this.since > this.patience) {
      this.rose = now;
      return this.step(-1, now);
    }
    return false;
  }

  private step(by: number, now: number): boolean {
    this.at += by;
    this.since = now;
    this.paces = [];
    return true;
  }
}
