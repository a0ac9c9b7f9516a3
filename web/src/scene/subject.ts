// What a device's own picture must be able to do; the page around it does not ask which device it is.

import type { Sample, Vector } from "../sample";
import type { ForceMap, Mesh } from "../wire";

/** Where the hand should go next [m], and how it turns the mover; without `q` the device decides. */
export interface Wish {
  p: Vector;
  q?: readonly [number, number, number, number];
}

export interface Subject {
  /** the sentence for the first minute, and what each key does here */
  readonly hint: string;
  readonly keys: readonly (readonly [string, string])[];
  /** what full colour means: of the force map [N], or of the coils [A] */
  readonly range: number;
  readonly arrowVisible: boolean;
  /** Draw this sample; true if the picture changed visibly. */
  show(sample: Sample): boolean;
  /** Grey, without numbers: nothing is known any more. */
  forget(): void;
  /** Known again. */
  live(): void;
  shape(mesh: Mesh): void;
  paint(map: ForceMap): void;
  /** What is painted in a direction. */
  forceAt(direction: readonly number[]): { force: number; saturated: boolean };
  /** Whether a pointer at (x, y) [px] would take hold, within `reach` pixels. */
  near(x: number, y: number, reach: number): boolean;
  /** Take hold at (x, y), drag to (x, y), press in or lift by millimetres. Each gives the hand's next wish. */
  grab(x: number, y: number): Wish;
  drag(x: number, y: number): Wish;
  press(millimetres: number): Wish;
  /** Move by degrees on the screen: to the right and upwards. */
  nudge(right: number, up: number): Wish;
  /** Turn the mover about its own axis by degrees, where it can be turned. */
  spin?(degrees: number): Wish;
  /** Places on the canvas that words refer to [px]. */
  anchor(): { x: number; y: number };
  /** How many coils are drawn, and where the mover is drawn [m]; NaN: it is not. */
  picture?(): { coils: number; mover: number[] };
  /** Near end, middle and far end of what is held, on the page [px]. */
  places(): { x: number; y: number }[];
}
