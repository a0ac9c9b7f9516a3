// Readouts with the mover's position in Cartesian coordinates.

import { norm, type Sample } from "../sample";
import type { Session } from "../session";
import { at, formatNumber, write } from "./dom";
import { Readouts } from "./readouts";

const IDS = ["tilt", "azimuth", "distance"]; // elements reused for x, y and z

export class PlaceReadouts extends Readouts {
  constructor(session: Session) {
    super(session);
    IDS.forEach((id, i) => {
      const box = at(id).closest("div")!;
      write(box.querySelector("dt")!, "xyz"[i]!);
      box.querySelector("dd")!.lastChild!.textContent = " mm";
    });
  }

  protected override place(sample: Sample): void {
    sample.vector("p").forEach((metres, i) => write(at(IDS[i]!), formatNumber(metres * 1000, 1)));
  }

  override sentence(sample: Sample): string {
    const delivered = norm(sample.vector("wrench_actual"));
    if (!Number.isFinite(delivered)) return "";
    const place = sample.vector("p").map((metres) => formatNumber(metres * 1000, 0));
    return `${delivered.toFixed(1)} newton delivered at ${place.join(", ")} millimetres`;
  }
}
