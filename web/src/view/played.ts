// What the timeline's page and the page of each recording say to each other. They are of one server, in frames.

/** A recording, as the server describes it. */
export interface Recorded {
  name: string;
  rows: number;
  /** time of the first tick on the loop's clock, and from it to the last [s] */
  start: number;
  seconds: number;
  notices: string[];
  /** names of the worlds by the number of the change */
  changes: Record<string, string>;
}

/** The page of one recording, as its `window.player`. */
export interface PlayerHandle {
  /** Show the recording `t` seconds after its first tick; `speed`: it plays so fast, 0: it rests, NaN: it is scrubbed. */
  show(t: number, speed: number): void;
  /** Time of the tick `steps` after the one that is shown [s]. */
  neighbour(steps: number): number;
  help(): void;
  /** what is shown: time after the first tick [s], tick, how often it was drawn, and whether it is what was asked for */
  readonly shown: { t: number; tick: number; drawn: number; settled: boolean };
  /** numbers of the row that is shown, by the name of the column */
  value(name: string): number[];
  readonly status: string;
  readonly samples: number;
  /** median time per frame for the picture and for the plots [ms], and how much is drawn */
  readonly costs: { scene: number; plots: number; level: string };
  readonly heap: number;
  shapes(): (number[] | null)[];
  forceAt(direction: [number, number, number]): number;
}

/** The page with the timeline, as its `window.timeline`. */
export interface TimelineHandle {
  key(event: KeyboardEvent): boolean;
  readonly time: number;
  readonly playing: boolean;
  readonly speed: number;
  readonly loop: boolean;
  readonly marks: { t: number; text: string }[];
  readonly overview: number;
  go(t: number): void;
}

declare global {
  interface Window {
    player?: PlayerHandle;
    timeline?: TimelineHandle;
  }
}

/** What the keys of the timeline do, for the dialog. */
export const KEYS = [
  ["Space, K", "play or pause"],
  ["← →", "one tick back or forward"],
  ["↑ ↓, or Shift with ← →", "0.1 s forward or back"],
  ["Page up, Page down", "10 s forward or back"],
  ["Home, End", "to the first or the last tick"],
  ["[ ]", "to the previous or next mark: a trip, a change of world, missing ticks"],
  ["− +", "slower, faster"],
  ["L", "loop the part between I and O, or everything"],
  ["I, O", "start, or end, the loop here"],
] as const;
