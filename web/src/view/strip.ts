// One recording's curve over the whole time, with its marks, drawn only when something of it changed.

import { css, onThemeChange } from "../theme";
import { make } from "../panels/dom";
import type { Overview } from "./overview";

/** What can be drawn: the area's channel, the line's, and how a number of theirs is shown. */
export interface Quantity {
  name: string;
  area: string;
  line: string;
  unit: string;
  shift: number;
}

export const QUANTITIES: Quantity[] = [
  { name: "force", area: "force delivered", line: "force commanded", unit: "N", shift: 0 },
  { name: "torque", area: "torque delivered", line: "torque commanded", unit: "N·m", shift: 0 },
  { name: "currents", area: "currents", line: "", unit: "A", shift: 0 },
  { name: "temperature", area: "temperature", line: "", unit: "°C", shift: -273.15 },
];

const MARKS = { trip: "--bad", world: "--accent", gap: "--warn" } as const;

export class Strip {
  readonly canvas = make("canvas", {});
  private overview: Overview | null = null;
  private stale = true;

  constructor(
    private readonly name: string,
    private quantity: Quantity,
    /** where the recording lies on the time line [s], and how long that is */
    private place: { from: number; seconds: number; begin: number; end: number },
  ) {
    this.canvas.ariaHidden = "true";
    new ResizeObserver(() => (this.stale = true)).observe(this.canvas);
    onThemeChange(() => (this.stale = true));
  }

  show(overview: Overview): void {
    this.overview = overview;
    this.stale = true;
  }

  choose(quantity: Quantity): void {
    this.quantity = quantity;
    this.stale = true;
  }

  layOut(place: Strip["place"]): void {
    this.place = place;
    this.stale = true;
  }

  draw(): void {
    if (!this.stale) return;
    this.stale = false;
    const { canvas } = this;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!width || !height) return;
    const sharp = Math.min(devicePixelRatio, 2);
    canvas.width = Math.round(width * sharp);
    canvas.height = Math.round(height * sharp);
    const ink = canvas.getContext("2d")!;
    ink.scale(sharp, sharp);
    this.curve(ink, width, height);
    this.marks(ink, width, height);
  }

  private x(t: number, width: number): number {
    const { begin, end, from } = this.place;
    return ((from + t - begin) / Math.max(end - begin, 1e-9)) * width;
  }

  private curve(ink: CanvasRenderingContext2D, width: number, height: number): void {
    const { area, line, unit, shift } = this.quantity;
    const shown = this.overview?.ranges.get(area);
    const asked = line ? this.overview?.ranges.get(line) : undefined;
    const { seconds } = this.place;
    ink.strokeStyle = css("--line");
    ink.strokeRect(this.x(0, width) + 0.5, 0.5, this.x(seconds, width) - this.x(0, width) - 1, height - 1);
    ink.font = `14px ${css("--font")}`;
    if (!shown) return;
    let [low, high] = [Infinity, -Infinity];
    for (const range of [shown, asked]) {
      for (const value of range?.least ?? []) if (value < low) low = value;
      for (const value of range?.most ?? []) if (value > high) high = value;
    }
    if (high < low) return this.label(ink, `${this.name} no ${this.quantity.name} in it`, width);
    if (low >= 0 && shift === 0) low = 0;
    if (high - low < 1e-9) high = low + 1e-9;
    const y = (value: number): number => height - 3 - ((value - low) / (high - low)) * (height - 22);
    const bins = shown.least.length;
    const step = seconds / bins;
    const [begin, end] = [this.x(0, width), this.x(seconds, width)];
    ink.fillStyle = css("--given");
    // One column of pixels at a time, whatever lies in it: the area down to the axis pale, from least to most full.
    for (let x = Math.max(0, Math.floor(begin)); x < Math.min(width, end); x++) {
      const share = (one: number): number => Math.min(Math.max(((one - begin) / Math.max(end - begin, 1e-9)) * bins, 0), bins - 1);
      let [least, most] = [Infinity, -Infinity];
      for (let k = Math.floor(share(x)); k <= Math.ceil(share(x + 1) - 1e-9) - 1 || k === Math.floor(share(x)); k++) {
        if (shown.least[k]! < least) least = shown.least[k]!;
        if (shown.most[k]! > most) most = shown.most[k]!;
      }
      if (most < least) continue;
      ink.globalAlpha = 0.35;
      ink.fillRect(x, y(most), 1, y(low) - y(most));
      ink.globalAlpha = 1;
      ink.fillRect(x, y(most), 1, Math.max(y(least) - y(most), 1));
    }
    if (asked) {
      ink.strokeStyle = css("--asked");
      ink.setLineDash([4, 3]);
      ink.beginPath();
      let pen = false;
      for (let k = 0; k < bins; k++) {
        const most = asked.most[k]!;
        if (Number.isNaN(most)) pen = false;
        else if (pen) ink.lineTo(this.x((k + 0.5) * step, width), y(most));
        else {
          ink.moveTo(this.x((k + 0.5) * step, width), y(most));
          pen = true;
        }
      }
      ink.stroke();
      ink.setLineDash([]);
    }
    const digits = (value: number): string => String(Number((value + shift).toPrecision(3))).replace("-", "−");
    const words = `${this.name} ${this.quantity.name} ${digits(low)} to ${digits(high)} ${unit}`;
    this.label(ink, words.trim(), width);
  }

  private label(ink: CanvasRenderingContext2D, text: string, width: number): void {
    const left = Math.max(this.x(0, width), 0) + 6;
    ink.fillStyle = css("--bg");
    ink.globalAlpha = 0.75;
    ink.fillRect(left - 3, 1, ink.measureText(text).width + 6, 17);
    ink.globalAlpha = 1;
    ink.fillStyle = css("--muted");
    ink.fillText(text, left, 14);
  }

  /** A triangle for a trip, a diamond for another world, a bar for missing ticks: not by colour alone. */
  private marks(ink: CanvasRenderingContext2D, width: number, height: number): void {
    for (const { kind, t } of this.overview?.marks ?? []) {
      const x = this.x(t, width);
      ink.fillStyle = ink.strokeStyle = css(MARKS[kind]);
      ink.beginPath();
      ink.moveTo(x, 0);
      ink.lineTo(x, height);
      ink.lineWidth = kind === "trip" ? 2 : 1;
      ink.stroke();
      ink.beginPath();
      if (kind === "trip") {
        ink.moveTo(x - 6, height);
        ink.lineTo(x + 6, height);
        ink.lineTo(x, height - 11);
      } else if (kind === "world") {
        ink.moveTo(x, height - 11);
        ink.lineTo(x + 5, height - 6);
        ink.lineTo(x, height - 1);
        ink.lineTo(x - 5, height - 6);
      } else ink.rect(x - 1, height - 12, 3, 12);
      ink.fill();
    }
    ink.lineWidth = 1;
  }
}
