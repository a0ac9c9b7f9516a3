// Legend: colour bar of force or current, marker of the present force, and scale bar.

import { dot, norm, type Sample } from "../sample";
import type { RenderedQuantity, Scene } from "../session";
import { mapPixels, onThemeChange } from "../theme";
import { at, make, formatNumber, write } from "./dom";

/** narrow screens have a horizontal colour bar; same width as in style.css */
const NARROW = matchMedia("(max-width: 700px)");
const BAR_LENGTH_PX = 256; // of the canvas, which is scaled
const BAR_THICKNESS_PX = 18;

export class Legend {
  private range = 0;
  private painted = true;
  /** note on parts that are not drawn to scale */
  private scaleNote = "";

  constructor(private readonly words: readonly [string, string] = [" pushes", " pulls"]) {
    onThemeChange(() => this.paint());
    NARROW.addEventListener("change", () => this.paint());
    this.paint();
  }

  /** Set the colour scale to ±`range`; 0 hides it. */
  scale(range: number): void {
    at("arrows").hidden = false;
    at("legend").hidden = range === 0;
    if (range === this.range || range === 0) return;
    this.range = range;
    const ticks = at("ticks");
    ticks.replaceChildren();
    for (const share of [1, 0.5, 0, -0.5, -1]) {
      const word = share === 1 ? this.words[0] : share === -1 ? this.words[1] : "";
      const sign = share > 0 ? "+" : "";
      const tick = make("li", {}, `${sign}${formatNumber(share * range, range < 0.2 ? 3 : 2)}${word}`);
      tick.style.setProperty("--share", `${share}`);
      ticks.append(tick);
    }
  }

  /** Show the legend of the arrows only. */
  arrows(): void {
    at("arrows").hidden = false;
  }

  /** Add entries for field sensors, and note coils that are not to scale. */
  device({ parts = [], sensors = [] }: Scene): void {
    if (sensors.length) {
      at("arrows").append(make("li", {}, make("span", { className: "chip", ariaHidden: "true" }), "field sensor"));
    }
    if (parts.some(({ stated }) => !stated)) this.scaleNote = ", coils not to scale";
  }

  /** Use the colour scale for coil currents up to ±`range` [A], and label the arrows with the rendered quantity. */
  coils(range: number, gives: RenderedQuantity): void {
    const legend = at("legend");
    write(legend.querySelector("figcaption")!, "coil current, A");
    legend.querySelector<HTMLElement>(".key")!.hidden = true;
    at("bar").ariaLabel = "Colour scale of the coils' currents";
    this.scale(range);
    for (const [kind, word] of [["given", "delivered"], ["asked", "commanded"]] as const) {
      at("arrows").querySelector(`.arrow.${kind}`)!.nextSibling!.textContent = `${gives} ${word}`;
    }
    this.painted = false;
  }

  show(sample: Sample): void {
    if (!this.painted) {
      at("marker").hidden = true;
      return;
    }
    const p = sample.vector("p");
    const radial = dot(sample.vector("wrench_actual"), p) / norm(p);
    const marker = at("marker");
    marker.hidden = !(Number.isFinite(radial) && this.range > 0);
    if (!marker.hidden) marker.style.setProperty("--share", `${Math.min(1, Math.max(-1, radial / this.range))}`);
  }

  /** Set the scale bar; `pixels`: pixels per millimetre. */
  length(pixels: number): void {
    const millimetres = [5, 10, 20, 50].find((mm) => mm * pixels > 45) ?? 100;
    const box = at("scale");
    box.querySelector<HTMLElement>("span")!.style.width = `${millimetres * pixels}px`;
    write(box.querySelector("b")!, `${millimetres} mm${this.scaleNote}`);
  }

  private paint(): void {
    const canvas = at<HTMLCanvasElement>("bar");
    const context = canvas.getContext("2d")!;
    const pixels = mapPixels();
    canvas.width = NARROW.matches ? BAR_LENGTH_PX : BAR_THICKNESS_PX;
    canvas.height = NARROW.matches ? BAR_THICKNESS_PX : BAR_LENGTH_PX;
    for (let n = 0; n < BAR_LENGTH_PX; n++) {
      const k = 4 * Math.round((255 * n) / (BAR_LENGTH_PX - 1));
      context.fillStyle = `rgb(${pixels[k]} ${pixels[k + 1]} ${pixels[k + 2]})`;
      if (NARROW.matches) context.fillRect(n, 0, 1, BAR_THICKNESS_PX);
      else context.fillRect(0, BAR_LENGTH_PX - 1 - n, BAR_THICKNESS_PX, 1);
    }
  }
}
