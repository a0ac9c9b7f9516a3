// The colour bar with its newtons, the scale bar, and a mark at what is felt now.

import { dot, norm, type Sample } from "../sample";
import { mapPixels, onThemeChange } from "../theme";
import { at, make, shown, write } from "./dom";

export class Legend {
  private range = 0;

  constructor() {
    onThemeChange(() => this.paint());
    this.paint();
  }

  /** Full colour is at ±`range` newtons. */
  scale(range: number): void {
    if (range === this.range) return;
    this.range = range;
    at("legend").hidden = at("arrows").hidden = false;
    const ticks = at("ticks");
    ticks.replaceChildren();
    for (const share of [1, 0.5, 0, -0.5, -1]) {
      const word = share === 1 ? " pushes" : share === -1 ? " pulls" : "";
      const sign = share > 0 ? "+" : "";
      const tick = make("li", {}, `${sign}${shown(share * range, range < 0.2 ? 3 : 2)}${word}`);
      tick.style.top = `${50 - 50 * share}%`;
      ticks.append(tick);
    }
  }

  show(sample: Sample): void {
    const p = sample.vector("p");
    const radial = dot(sample.vector("given"), p) / norm(p);
    const marker = at("marker");
    marker.hidden = !(Number.isFinite(radial) && this.range > 0);
    if (!marker.hidden) marker.style.top = `${50 - 50 * Math.min(1, Math.max(-1, radial / this.range))}%`;
  }

  /** The scale bar, at `pixels` per millimetre. */
  length(pixels: number): void {
    const millimetres = [5, 10, 20, 50].find((mm) => mm * pixels > 45) ?? 100;
    const box = at("scale");
    box.querySelector<HTMLElement>("span")!.style.width = `${millimetres * pixels}px`;
    write(box.querySelector("b")!, `${millimetres} mm`);
  }

  private paint(): void {
    const canvas = at<HTMLCanvasElement>("bar");
    const context = canvas.getContext("2d")!;
    const pixels = mapPixels();
    for (let y = 0; y < canvas.height; y++) {
      const k = 4 * Math.round(255 * (1 - y / (canvas.height - 1)));
      context.fillStyle = `rgb(${pixels[k]} ${pixels[k + 1]} ${pixels[k + 2]})`;
      context.fillRect(0, y, canvas.width, 1);
    }
  }
}
