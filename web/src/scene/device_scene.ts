// How one kind of device is drawn. The page selects it once in `scenes.ts`, by the name that the server sends; no other
// code depends on the kind of device.

import type { Sample } from "../sample";
import type { RenderedQuantity, Session } from "../session";
import type { Home } from "./orbit";
import type { Stage } from "./stage";
import type { DeviceDrawing } from "./device_drawing";

/** Panel with the numbers of the present sample. */
export interface ReadoutPanel {
  show(sample: Sample): void;
  /** Summary for screen readers. */
  sentence(sample: Sample): string;
}

export interface DeviceScene {
  /** name of the part that is dragged, for the help */
  readonly held: string;
  /** whether the plots offer the radial force */
  readonly radial: boolean;
  /** what the colours show: the force map, the coil currents, or nothing */
  readonly colours: "force" | "currents" | "none";
  home(session: Session): Home;
  drawing(stage: Stage, session: Session): DeviceDrawing;
  readouts(session: Session): ReadoutPanel;
}

/** Index of the first component of the rendered quantity in a wrench. */
export const firstOf = (gives: RenderedQuantity): 0 | 3 => (gives === "torque" ? 3 : 0);
