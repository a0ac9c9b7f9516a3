// Readouts of force, torque, position, currents and temperatures.

import { norm, spherical, type Sample } from "../sample";
import type { Session } from "../session";
import { duration } from "../status";
import { at, make, formatNumber, write } from "./dom";

const ZERO_CELSIUS_K = 273.15;

export class Readouts {
  private readonly cells: { current: HTMLElement; temperature: HTMLElement }[] = [];
  /** whether torque is shown */
  private showsTorque = false;

  constructor(private readonly session: Session) {
    const body = at("coils").querySelector("tbody")!;
    session.coils.forEach((name, i) => {
      const swatch = make("span", { className: "swatch" });
      swatch.style.background = `var(--s${"xyz"[i % 3]!})`;
      const head = make("th", { scope: "row" }, swatch, name);
      const current = make("td", {}, "–");
      const temperature = make("td", {}, "–");
      body.append(make("tr", {}, head, current, temperature));
      this.cells.push({ current, temperature });
    });
  }

  show(sample: Sample): void {
    write(at("asked"), formatNumber(norm(sample.vector("wrench_commanded")), 2));
    write(at("given"), formatNumber(norm(sample.vector("wrench_actual")), 2));
    this.showTorque(sample);
    this.place(sample);
    const currents = sample.list("current_measured");
    const windings = sample.list("winding");
    this.cells.forEach(({ current, temperature }, i) => {
      const celsius = windings[i]! - ZERO_CELSIUS_K;
      write(current, formatNumber(currents[i]!, 2));
      write(temperature, formatNumber(celsius, 1));
      temperature.classList.toggle("hot", celsius >= this.session.limits.warn);
    });
    const left = sample.number("remaining");
    write(at("remaining"), Number.isNaN(left) ? "–" : duration(left) || "no limit");
  }

  /** Torque commanded and delivered, and its limit; shown if the world renders torque. */
  private showTorque(sample: Sample): void {
    const part = sample.number("part");
    const commanded = norm(sample.vector("wrench_commanded", 3));
    if (!Number.isNaN(part)) this.showsTorque = part > 0 || commanded > 0;
    at("turning").hidden = at("part").hidden = !this.showsTorque;
    if (!this.showsTorque) return;
    write(at("torque-asked"), formatNumber(1000 * commanded, 1));
    write(at("torque-given"), formatNumber(1000 * norm(sample.vector("wrench_actual", 3)), 1));
    const limit = this.session.saturations[sample.number("saturated")];
    write(at("part"), `${this.session.parts[part] ?? ""}${limit ? ` Limited by ${limit}.` : ""}`.trim());
  }

  /** Position of the mover. */
  protected place(sample: Sample): void {
    const { tilt, azimuth, length } = spherical(sample.vector("p"));
    write(at("tilt"), formatNumber(tilt, 1));
    write(at("azimuth"), formatNumber(azimuth, 0));
    write(at("distance"), formatNumber(length * 1000, 1));
  }

  /** Summary for screen readers. */
  sentence(sample: Sample): string {
    const delivered = norm(sample.vector("wrench_actual"));
    if (!Number.isFinite(delivered)) return "";
    const { tilt, length } = spherical(sample.vector("p"));
    return `${delivered.toFixed(1)} newton delivered at ${tilt.toFixed(0)} degrees, ${(length * 1000).toFixed(0)} millimetres`;
  }
}
