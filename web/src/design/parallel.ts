// Parallel-coordinates plot of parameters and objectives; ranges on its axes filter the designs.

import { make } from "../panels/dom";
import { css } from "../theme";
import { formatNumber, marks, range, titleOf, valueAt, type Column, type Designs } from "./designs";
import { Layers } from "./layers";

const MARGIN_PX = { top: 14, bottom: 14 };
const MIN_AXIS_SPACING_PX = 108;
const LINES_PER_FRAME = 1500;
const HIGHLIGHT_RADIUS_PX = 24; // around the pointer
const AXIS_GRAB_RADIUS_PX = 18;
const CLICK_RADIUS_PX = 4; // a shorter drag is a click
const SEVERAL = "several"; // option for a filter that keeps several choices, or none

export class Parallel {
  readonly root = make("div", { className: "parallel" });
  private readonly layers: Layers;
  private readonly columns: Column[];
  private readonly ends: [number, number][];
  private readonly filters = new Map<Column, [number, number]>();
  private readonly count = make("p", { className: "soft", role: "status" });
  private readonly which = make("select");
  private readonly from = make("input", { type: "number", step: "any" });
  private readonly to = make("input", { type: "number", step: "any" });
  private readonly choice = make("select");
  private readonly numeric = [make("label", {}, "from ", this.from), make("label", {}, "to ", this.to)];
  private readonly named = make("label", {}, "which is ", this.choice);
  /** whether all lines are drawn */
  drawn = false;
  private marked = -1;
  private task = 0;
  private held: { column: Column; start: number } | null = null;

  /** `mark`: called for the design at the pointer; `filter`: called with 1 for each design that is kept, null: all. */
  constructor(
    private readonly designs: Designs,
    private readonly mark: (row: number) => void,
    private readonly filter: (kept: Uint8Array | null) => void,
  ) {
    this.columns = designs.columns.filter(({ kind }) => kind !== "constraint");
    this.ends = this.columns.map((column) => range(designs, column, false));
    this.layers = new Layers("lines", () => this.draw());
    const heads = this.columns.map((column) => make("span", {}, titleOf(column)));
    const wide = make("div", { className: "axes" }, make("div", { className: "heads" }, ...heads), this.layers.box);
    wide.style.minWidth = `${this.columns.length * MIN_AXIS_SPACING_PX}px`;
    const scroll = make("div", { className: "wide", tabIndex: 0, role: "group" }, wide);
    scroll.ariaLabel = "Parallel coordinates; the filters below set the same ranges by keyboard";
    this.root.append(scroll, this.form(), this.count);
    this.listen();
    this.updateStatus(null);
  }

  private form(): HTMLElement {
    this.which.append(...this.columns.map((one, k) => make("option", { value: String(k) }, titleOf(one))));
    const set = make("button", { type: "button" }, "Filter");
    const clear = make("button", { type: "button" }, "Clear all filters");
    set.addEventListener("click", () => {
      const value = (input: HTMLInputElement, other: number): number => (Number.isFinite(input.valueAsNumber) ? input.valueAsNumber : other);
      const column = this.columns[Number(this.which.value)]!;
      if (column.labels) {
        const place = Number(this.choice.value);
        if (this.choice.value !== SEVERAL) this.set(column, place < 0 ? null : [place, place]);
        return;
      }
      const [low, high] = [value(this.from, -Infinity), value(this.to, Infinity)];
      this.set(column, low === -Infinity && high === Infinity ? null : [low, high]);
    });
    clear.addEventListener("click", () => {
      this.filters.clear();
      this.updateFields();
      this.apply();
    });
    this.which.addEventListener("change", () => this.updateFields());
    this.updateFields();
    const show = make("label", {}, "Show only ", this.which);
    return make("div", { className: "pickers" }, show, ...this.numeric, this.named, set, clear);
  }

  /** Show the filter of the selected column in the input fields. */
  private updateFields(): void {
    const column = this.columns[Number(this.which.value)]!;
    const span = this.filters.get(column);
    for (const field of this.numeric) field.hidden = column.labels !== null;
    this.named.hidden = column.labels === null;
    const text = (value: number | undefined): string => (value !== undefined && Number.isFinite(value) ? String(Number(value.toPrecision(4))) : "");
    [this.from.value, this.to.value] = [text(span?.[0]), text(span?.[1])];
    if (!column.labels) return;
    const names = column.labels.map((label, place) => make("option", { value: String(place) }, label));
    this.choice.replaceChildren(make("option", { value: "-1" }, "any"), ...names, make("option", { value: SEVERAL, hidden: true }, "several of them"));
    const kept = span ? column.labels.flatMap((_, place) => (place >= span[0] && place <= span[1] ? [place] : [])) : [-1];
    this.choice.value = kept.length === 1 ? String(kept[0]) : SEVERAL;
  }

  private set(column: Column, span: [number, number] | null): void {
    if (span) this.filters.set(column, span);
    else this.filters.delete(column);
    this.which.value = String(this.columns.indexOf(column));
    this.updateFields();
    this.apply();
  }

  private apply(): void {
    const kept = this.filters.size ? new Uint8Array(this.designs.names.length).fill(1) : null;
    for (const [column, [low, high]] of this.filters) {
      kept!.forEach((_, row) => {
        const value = valueAt(column, row);
        if (!(value >= low && value <= high)) kept![row] = 0;
      });
    }
    this.updateStatus(kept);
    this.filter(kept);
    this.kept = kept;
    this.draw();
  }

  private kept: Uint8Array | null = null;

  private updateStatus(kept: Uint8Array | null): void {
    const all = this.designs.names.length;
    const named = [...this.filters].map(([column, span]) => `${column.title} ${describeFilter(column, span)}`);
    this.count.textContent = kept
      ? `${kept.reduce((sum, one) => sum + one, 0)} of ${all} designs: ${named.join("; ")}.`
      : "Drag along an axis to show only designs within that range; click the axis to show all again.";
  }

  /** Highlight a design. */
  show(row: number): void {
    this.marked = row;
    this.drawOverlay();
  }

  private across(k: number): number {
    return ((k + 0.5) * this.layers.width) / this.columns.length;
  }

  private up(k: number, row: number): number {
    const [low, high] = this.ends[k]!;
    return this.height(k, Math.min(Math.max(valueAt(this.columns[k]!, row), low), high));
  }

  private height(k: number, value: number): number {
    const [low, high] = this.ends[k]!;
    const room = this.layers.height - MARGIN_PX.top - MARGIN_PX.bottom;
    return MARGIN_PX.top + (1 - (value - low) / (high - low)) * room;
  }

  private listen(): void {
    const { box } = this.layers;
    const axis = (x: number): number => Math.min(Math.max(Math.floor((x * this.columns.length) / this.layers.width), 0), this.columns.length - 1);
    const value = (k: number, y: number): number => {
      const [low, high] = this.ends[k]!;
      const room = this.layers.height - MARGIN_PX.top - MARGIN_PX.bottom;
      return low + (1 - Math.min(Math.max((y - MARGIN_PX.top) / room, 0), 1)) * (high - low);
    };
    box.addEventListener("pointerdown", (event) => {
      const [x, y] = this.layers.place(event);
      const k = axis(x);
      if (event.button || Math.abs(this.across(k) - x) > AXIS_GRAB_RADIUS_PX) return;
      box.setPointerCapture(event.pointerId);
      this.held = { column: this.columns[k]!, start: y };
      event.preventDefault();
    });
    box.addEventListener("pointermove", (event) => {
      const [x, y] = this.layers.place(event);
      if (this.held) return this.drawOverlay(y);
      box.style.cursor = Math.abs(this.across(axis(x)) - x) > AXIS_GRAB_RADIUS_PX ? "crosshair" : "ns-resize";
      const row = this.nearest(x, y);
      if (row >= 0 && row !== this.marked) this.mark(row);
    });
    const end = (event: PointerEvent): void => {
      if (!this.held) return;
      const { column, start } = this.held;
      const [, y] = this.layers.place(event);
      this.held = null;
      const k = this.columns.indexOf(column);
      const span = [value(k, start), value(k, y)].sort((a, b) => a - b) as [number, number];
      this.set(column, Math.abs(y - start) < CLICK_RADIUS_PX ? null : span);
    };
    box.addEventListener("pointerup", end);
    box.addEventListener("pointercancel", () => (this.held = null));
  }

  private nearest(x: number, y: number): number {
    const step = this.layers.width / this.columns.length;
    const k = Math.min(Math.max(Math.floor(x / step - 0.5), 0), this.columns.length - 2);
    if (k < 0) return -1;
    const share = Math.min(Math.max((x - this.across(k)) / step, 0), 1);
    let best = -1;
    let least = HIGHLIGHT_RADIUS_PX;
    for (let row = 0; row < this.designs.names.length; row++) {
      if (this.kept && !this.kept[row]) continue;
      const away = Math.abs((1 - share) * this.up(k, row) + share * this.up(k + 1, row) - y);
      if (away < least) [best, least] = [row, away];
    }
    return best;
  }

  /** Draw all lines in batches, so that the page stays responsive; the front last, on top. */
  private draw(): void {
    cancelAnimationFrame(this.task);
    const context = this.layers.clear(0);
    this.drawn = false;
    if (!this.layers.width) return;
    const front = new Set(this.designs.front);
    const rows = this.designs.names.map((_, row) => row).filter((row) => !front.has(row) && (!this.kept || this.kept[row]));
    const opacity = Math.min(0.5, Math.max(0.05, 60 / rows.length));
    const drawBatch = (start: number): void => {
      context.globalAlpha = opacity;
      context.strokeStyle = css("--muted");
      context.lineWidth = 1;
      for (const row of rows.slice(start, start + LINES_PER_FRAME)) this.line(context, row);
      if (start + LINES_PER_FRAME < rows.length) {
        this.task = requestAnimationFrame(() => drawBatch(start + LINES_PER_FRAME));
        return;
      }
      context.globalAlpha = 0.7;
      context.strokeStyle = css("--accent");
      for (const row of this.designs.front) if (!this.kept || this.kept[row]) this.line(context, row);
      context.globalAlpha = 1;
      this.axes(context);
      this.drawn = true;
    };
    drawBatch(0);
    this.drawOverlay();
  }

  private line(context: CanvasRenderingContext2D, row: number): void {
    context.beginPath();
    for (let k = 0; k < this.columns.length; k++) context.lineTo(this.across(k), this.up(k, row));
    context.stroke();
  }

  private axes(context: CanvasRenderingContext2D): void {
    context.textAlign = "left";
    context.lineWidth = 1;
    this.columns.forEach((column, k) => {
      const x = this.across(k);
      context.strokeStyle = css("--text");
      context.beginPath();
      context.moveTo(x, MARGIN_PX.top);
      context.lineTo(x, this.layers.height - MARGIN_PX.bottom);
      context.stroke();
      const [low, high] = this.ends[k]!;
      context.lineWidth = 4;
      context.strokeStyle = css("--panel");
      context.fillStyle = css("--text");
      for (const [value, text] of marks(column, low, high, 5)) {
        const y = this.height(k, value);
        context.strokeText(text, x + 5, y + 4, MIN_AXIS_SPACING_PX - 30);
        context.fillText(text, x + 5, y + 4, MIN_AXIS_SPACING_PX - 30);
      }
      context.lineWidth = 1;
    });
  }

  /** Draw the highlighted design, the filters, and the range that is being dragged to `y`. */
  private drawOverlay(y = NaN): void {
    const context = this.layers.clear(1);
    context.fillStyle = css("--accent");
    context.globalAlpha = 0.35;
    const bar = (k: number, a: number, b: number): void => context.fillRect(this.across(k) - 7, Math.min(a, b), 14, Math.abs(a - b));
    for (const [column, [low, high]] of this.filters) {
      const k = this.columns.indexOf(column);
      const [bottom, top] = this.ends[k]!;
      bar(k, this.height(k, Math.max(low, bottom)), this.height(k, Math.min(high, top)));
    }
    if (this.held && Number.isFinite(y)) bar(this.columns.indexOf(this.held.column), this.held.start, y);
    context.globalAlpha = 1;
    if (this.marked < 0) return;
    context.strokeStyle = css("--warn");
    context.lineWidth = 3;
    this.line(context, this.marked);
  }
}

/** Describe the range of a filter. */
function describeFilter(column: Column, [low, high]: [number, number]): string {
  if (column.labels) return column.labels.filter((_, place) => place >= low && place <= high).join(" or ") || "none";
  return `${formatNumber(low)} to ${formatNumber(high)}`.replaceAll("–", "any");
}
