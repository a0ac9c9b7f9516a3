// How one kind of device is shown. The page asks the table in `scenes.ts` once, by the name that the server gives, and
// nowhere else which device it is.

import type { Sample } from "../sample";
import type { Gives, Session } from "../session";
import type { Home } from "./orbit";
import type { Stage } from "./stage";
import type { Subject } from "./subject";

/** The numbers of this moment. */
export interface Readings {
  show(sample: Sample): void;
  /** The same, as a sentence for those who listen. */
  sentence(sample: Sample): string;
}

export interface DeviceScene {
  /** the part that is dragged, as the help calls it */
  readonly held: string;
  /** whether the radial part of the force is worth a plot of its own */
  readonly radial: boolean;
  /** what the colours mean: a force painted in the picture, the coils' currents, or nothing */
  readonly colours: "force" | "currents" | "none";
  home(session: Session): Home;
  subject(stage: Stage, session: Session): Subject;
  readings(session: Session): Readings;
}

/** Where what a device gives begins in a wrench of six numbers. */
export const firstOf = (gives: Gives): 0 | 3 => (gives === "torque" ? 3 : 0);
