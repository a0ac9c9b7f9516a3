// The numbers of this moment for a device of which only the mover's place is known.

import { norm, type Sample } from "../sample";
import type { Session } from "../session";
import { at, formatNumber, write } from "./dom";
import { Readouts } from "./readouts";

const PLACES = ["tilt", "azimuth", "distance"]; // the page's three numbers: here x, y, z

export class PlaceReadouts extends Readouts {
  constructor(session: Session) {
    super(session);
    PLACES.forEach((id, i) => {
      const box = at(id).closest("div")!;
      write(box.querySelector("dt")!, "xyz"[i]!);
      box.querySelector("dd")!.lastChild!.textContent = " mm";
    });
  }

  protected override place(sample: Sample): void {
    sample.vector("p").forEach((metres, i) => write(at(PLACES[i]!), formatNumber(metres * 1000, 1)));
  }

  override sentence(sample: Sample): string {
    const given = norm(sample.vector("wrench_actual"));
    if (!Number.isFinite(given)) return "";
    const place = sample.vector("p").map((metres) => formatNumber(metres * 1000, 0));
    return `${given.toFixed(1)} newton delivered at ${place.join(", ")} millimetres`;
  }
}
