// Interface of the drawing of a device, through which the page works without knowing the kind of device.

import type { Sample } from "../sample";
import type { ForceMap, HandGoal, Mesh } from "../wire";

export interface DeviceDrawing {
  /** hint for a new user, and the effect of each key */
  readonly hint: string;
  readonly keys: readonly (readonly [string, string])[];
  /** full scale of the colours: force map [N], or coil currents [A] */
  readonly range: number;
  readonly arrowVisible: boolean;
  /** Draw this sample; returns whether the drawing changed visibly. */
  show(sample: Sample): boolean;
  /** Draw in grey, without arrows: the page is not live. */
  forget(): void;
  /** Draw normally again. */
  live(): void;
  shape(mesh: Mesh): void;
  paint(map: ForceMap): void;
  /** Force map in a direction. */
  forceAt(direction: readonly number[]): { force: number; saturated: boolean };
  /** Whether (x, y) is within `reach` of the part that can be grabbed [px]. */
  near(x: number, y: number, reach: number): boolean;
  /** Grab at (x, y), drag to (x, y) [px], lift or press (negative) [mm]; each returns the new hand goal. */
  grab(x: number, y: number): HandGoal;
  drag(x: number, y: number): HandGoal;
  press(millimetres: number): HandGoal;
  /** Move by keys: steps to the right and upwards on the screen. */
  nudge(right: number, up: number): HandGoal;
  /** Spin the mover about its axis [deg], if the device allows it. */
  spin?(degrees: number): HandGoal;
  /** Position on the canvas for the hint [px]. */
  anchor(): { x: number; y: number };
  /** Number of coils drawn, and drawn position of the mover [m]; NaN: not drawn. */
  picture?(): { coils: number; mover: number[] };
  /** Near end, middle and far end of the held part on the page [px]. */
  places(): { x: number; y: number }[];
}
