// Interface between the timeline's page and the page of each recording, which it shows in an iframe of the same origin.

/** Description of a recording from the server. */
export interface Recorded {
  name: string;
  rows: number;
  /** time of the first tick on the loop's clock, and duration [s] */
  start: number;
  seconds: number;
  notices: string[];
  /** names of the worlds by number of the change */
  changes: Record<string, string>;
}

/** Interface of a recording's page, `window.player`. */
export interface PlayerHandle {
  /** Show time `t` [s] after the first tick. `speed`: playback speed; 0: paused or scrubbing. */
  show(t: number, speed: number): void;
  /** Time of the tick that is `steps` after the shown one [s]. */
  neighbour(steps: number): number;
  help(): void;
  /** shown time after the first tick [s], tick, number of redraws, and whether row and plots are up to date */
  readonly shown: { t: number; tick: number; drawn: number; settled: boolean };
  /** values of a column in the shown row */
  value(name: string): number[];
  readonly status: string;
  readonly samples: number;
  /** median time per frame of the 3D view and of the plots [ms], and level of detail */
  readonly costs: { scene: number; plots: number; level: string };
  readonly heap: number;
  shapes(): (number[] | null)[];
  forceAt(direction: [number, number, number]): number;
}

/** Interface of the timeline's page, `window.timeline`. */
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

/** Keys of the timeline, for the help dialog. */
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
