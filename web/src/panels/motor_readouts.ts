// Readouts of a motor: torque, angles of the handle, and current and temperature of each channel.

import { norm, type Sample } from "../sample";
import { angles, axis } from "../scene/rotor_angles";
import type { Session } from "../session";
import { duration } from "../status";
import { channelColour, onThemeChange } from "../theme";
import { at, make, formatNumber, write } from "./dom";

const ZERO_CELSIUS_K = 273.15;
const DEG_PER_RAD = 180 / Math.PI;

export class MotorReadouts {
  private readonly cells: { current: HTMLElement; temperature: HTMLElement; swatch: HTMLElement }[] = [];

  constructor(private readonly session: Session) {
    for (const [id, word] of [["asked", "commanded"], ["given", "delivered"]] as const) {
      const box = at(id).closest("div")!;
      write(box.querySelector("dt")!, `torque ${word}`);
      box.querySelector("dd")!.lastChild!.textContent = " N·m";
    }
    const distance = at("distance").closest("div")!;
    write(distance.querySelector("dt")!, "spin");
    distance.querySelector("dd")!.lastChild!.textContent = "°";
    const head = at("coils").querySelector("thead tr")!;
    head.append(...[...head.children].map((cell) => cell.cloneNode(true)));
    const body = at("coils").querySelector("tbody")!;
    const half = Math.ceil(session.coils.length / 2);
    const rows = Array.from({ length: half }, () => make("tr", {}));
    body.append(...rows);
    session.coils.forEach((name, i) => {
      const swatch = make("span", { className: "swatch" });
      const current = make("td", {}, "–");
      const temperature = make("td", {}, "–");
      rows[i % half]!.append(make("th", { scope: "row" }, swatch, name), current, temperature);
      this.cells.push({ current, temperature, swatch });
    });
    onThemeChange(() => this.dress());
    this.dress();
  }

  show(sample: Sample): void {
    write(at("asked"), formatNumber(norm(sample.vector("wrench_commanded", 3)), 3));
    write(at("given"), formatNumber(norm(sample.vector("wrench_actual", 3)), 3));
    const q = sample.quaternion("q");
    const known = Number.isFinite(q[0]);
    const [x, y, z] = axis(q);
    write(at("tilt"), formatNumber(known ? Math.atan2(Math.hypot(x, y), z) * DEG_PER_RAD : NaN, 1));
    write(at("azimuth"), formatNumber(known ? Math.atan2(y, x) * DEG_PER_RAD : NaN, 0));
    write(at("distance"), formatNumber(known ? angles(q)[2] * DEG_PER_RAD : NaN, 1));
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

  /** Summary for screen readers. */
  sentence(sample: Sample): string {
    const delivered = norm(sample.vector("wrench_actual", 3));
    if (!Number.isFinite(delivered)) return "";
    const q = sample.quaternion("q");
    const [x, y, z] = axis(q);
    const tilt = Math.atan2(Math.hypot(x, y), z) * DEG_PER_RAD;
    return `${delivered.toFixed(2)} newton metres delivered, handle tilted ${tilt.toFixed(0)} degrees, spun ${formatNumber(angles(q)[2] * DEG_PER_RAD, 0)}`;
  }

  private dress(): void {
    this.cells.forEach(({ swatch }, i) => (swatch.style.background = channelColour(i, this.cells.length)));
  }
}
