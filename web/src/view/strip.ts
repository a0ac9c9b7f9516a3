// Curve and marks of one recording over the whole timeline; redrawn only after changes.

import { css, onThemeChange } from "../theme";
import { make } from "../panels/dom";
import type { Overview } from "./overview";

/** A quantity: channels for area and line, unit, and offset of displayed values. */
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
    /** start and duration of the recording, and limits of the timeline [s] */
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
    const pixelRatio = Math.min(devicePixelRatio, 2);
    canvas.width = Math.round(width * pixelRatio);
    canvas.height = Math.round(height * pixelRatio);
    const context = canvas.getContext("2d")!;
    context.scale(pixelRatio, pixelRatio);
    this.curve(context, width, height);
    this.marks(context, width, height);
  }

  private x(t: number, width: number): number {
    const { begin, end, from } = this.place;
    return ((from + t - begin) / Math.max(end - begin, 1e-9)) * width;
  }

  private curve(context: CanvasRenderingContext2D, width: number, height: number): void {
    const { area, line, unit, shift } = this.quantity;
    const shown = this.overview?.ranges.get(area);
    const commanded = line ? this.overview?.ranges.get(line) : undefined;
    const { seconds } = this.place;
    context.strokeStyle = css("--line");
    context.strokeRect(this.x(0, width) + 0.5, 0.5, this.x(seconds, width) - this.x(0, width) - 1, height - 1);
    context.font = `14px ${css("--font")}`;
    if (!shown) return;
    let [low, high] = [Infinity, -Infinity];
    for (const range of [shown, commanded]) {
      for (const value of range?.least ?? []) if (value < low) low = value;
      for (const value of range?.most ?? []) if (value > high) high = value;
    }
    if (high < low) return this.label(context, `${this.name} no ${this.quantity.name} in it`, width);
    if (low >= 0 && shift === 0) low = 0;
    if (high - low < 1e-9) high = low + 1e-9;
    const y = (value: number): number => height - 3 - ((value - low) / (high - low)) * (height - 22);
    const bins = shown.least.length;
    const step = seconds / bins;
    const [begin, end] = [this.x(0, width), this.x(seconds, width)];
    context.fillStyle = css("--delivered");
    // Per pixel column: a pale area down to the axis, and a solid bar from minimum to maximum.
    for (let x = Math.max(0, Math.floor(begin)); x < Math.min(width, end); x++) {
      const share = (one: number): number => Math.min(Math.max(((one - begin) / Math.max(end - begin, 1e-9)) * bins, 0), bins - 1);
      let [least, most] = [Infinity, -Infinity];
      for (let k = Math.floor(share(x)); k <= Math.ceil(share(x + 1) - 1e-9) - 1 || k === Math.floor(share(x)); k++) {
        if (shown.least[k]! < least) least = shown.least[k]!;
        if (shown.most[k]! > most) most = shown.most[k]!;
      }
      if (most < least) continue;
      context.globalAlpha = 0.35;
      context.fillRect(x, y(most), 1, y(low) - y(most));
      context.globalAlpha = 1;
      context.fillRect(x, y(most), 1, Math.max(y(least) - y(most), 1));
    }
    if (commanded) {
      context.strokeStyle = css("--commanded");
      context.setLineDash([4, 3]);
      context.beginPath();
      let pen = false;
      for (let k = 0; k < bins; k++) {
        const most = commanded.most[k]!;
        if (Number.isNaN(most)) pen = false;
        else if (pen) context.lineTo(this.x((k + 0.5) * step, width), y(most));
        else {
          context.moveTo(this.x((k + 0.5) * step, width), y(most));
          pen = true;
        }
      }
      context.stroke();
      context.setLineDash([]);
    }
    const digits = (value: number): string => String(Number((value + shift).toPrecision(3))).replace("-", "−");
    const words = `${this.name} ${this.quantity.name} ${digits(low)} to ${digits(high)} ${unit}`;
    this.label(context, words.trim(), width);
  }

  private label(context: CanvasRenderingContext2D, text: string, width: number): void {
    const left = Math.max(this.x(0, width), 0) + 6;
    context.fillStyle = css("--bg");
    context.globalAlpha = 0.75;
    context.fillRect(left - 3, 1, context.measureText(text).width + 6, 17);
    context.globalAlpha = 1;
    context.fillStyle = css("--muted");
    context.fillText(text, left, 14);
  }

  /** Draw marks, told apart by shape too: triangle for a trip, diamond for a change of world, bar for missing ticks. */
  private marks(context: CanvasRenderingContext2D, width: number, height: number): void {
    for (const { kind, t } of this.overview?.marks ?? []) {
      const x = this.x(t, width);
      context.fillStyle = context.strokeStyle = css(MARKS[kind]);
      context.beginPath();
      context.moveTo(x, 0);
      context.lineTo(x, height);
      context.lineWidth = kind === "trip" ? 2 : 1;
      context.stroke();
      context.beginPath();
      if (kind === "trip") {
        context.moveTo(x - 6, height);
        context.lineTo(x + 6, height);
        context.lineTo(x, height - 11);
      } else if (kind === "world") {
        context.moveTo(x, height - 11);
        context.lineTo(x + 5, height - 6);
        context.lineTo(x, height - 1);
        context.lineTo(x - 5, height - 6);
      } else context.rect(x - 1, height - 12, 3, 12);
      context.fill();
    }
    context.lineWidth = 1;
  }
}
