// Scatter plot of all designs over two columns, with Pareto front, base device and recommended designs.

import { make } from "../panels/dom";
import { css } from "../theme";
import { describe, marks, nameBase, range, titleOf, valueAt, type Column, type Designs } from "./designs";
import { Layers } from "./layers";

const MARGIN_PX = { left: 74, right: 18, top: 12, bottom: 46 };
const HIGHLIGHT_RADIUS_PX = 40; // around the pointer
const FRONT_DISTANCE_FACTOR = 0.6; // makes points of the front easier to hit
const LETTER_HEIGHT_PX = 12;
const LABEL_OFFSETS_PX: [number, number][] = [[6, -6], [6, 16], [-14, -6], [-14, 16], [20, 5]]; // candidates for the number of a recommended design

export class Scatter {
  readonly root = make("div", { className: "scatter" });
  readonly slider = make("div", { className: "slider", tabIndex: 0, role: "slider" });
  private readonly layers: Layers;
  private readonly beyond = make("p", { className: "soft" });
  private readonly whole = make("input", { type: "checkbox" });
  private x!: Column;
  private y!: Column;
  private places: Float32Array;
  private readonly front: Set<number>;
  private kept: Uint8Array | null = null;
  private marked = -1;
  private chosen = -1;

  /** `mark`: called for the design at the pointer; `choose`: called for a design chosen by click or Enter. */
  constructor(
    private readonly designs: Designs,
    private readonly mark: (row: number) => void,
    private readonly choose: (row: number) => void,
  ) {
    this.front = new Set(designs.front);
    this.places = new Float32Array(2 * designs.names.length);
    this.layers = new Layers("points", () => this.draw());
    const goals = designs.columns.filter(({ kind }) => kind === "objective");
    const [first, second] = goals.length > 1 ? [goals[0]!, goals[1]!] : [designs.columns[0]!, goals[0]!];
    const pickers = [this.picker("Horizontal axis", first, (one) => (this.x = one)), this.picker("Vertical axis", second, (one) => (this.y = one))];
    [this.x, this.y] = [first, second];
    this.whole.addEventListener("change", () => this.draw());
    this.slider.append(this.layers.box);
    this.slider.ariaLabel = designs.front.length > 1 ? "Designs of the Pareto front" : "Selected designs";
    this.root.append(
      make("div", { className: "pickers" }, ...pickers, make("label", { className: "check" }, this.whole, " include outliers")),
      this.slider,
      this.beyond,
    );
    this.listen();
  }

  private picker(name: string, now: Column, take: (column: Column) => void): HTMLElement {
    const { columns } = this.designs;
    const select = make("select", {}, ...columns.map((one, k) => make("option", { value: String(k) }, titleOf(one))));
    select.value = String(columns.indexOf(now));
    select.addEventListener("change", () => {
      take(columns[Number(select.value)]!);
      this.draw();
      this.updateSlider();
    });
    return make("label", {}, `${name} `, select);
  }

  /** Draw designs with 0 in `kept` faintly; null: none. */
  filter(kept: Uint8Array | null): void {
    this.kept = kept;
    this.draw();
  }

  /** Highlight a design. */
  show(row: number): void {
    this.marked = row;
    this.drawOverlay();
    this.updateSlider();
  }

  /** Mark a design as chosen. */
  setChosen(row: number): void {
    this.chosen = row;
    this.drawOverlay();
  }

  /** Designs for the arrow keys, left to right: the front, or the recommended designs if it is a single point. */
  private order(): number[] {
    const { front, picks } = this.designs;
    const rows = front.length > 1 ? front : [...new Set([...front, ...picks.map(({ row }) => row)])];
    return [...rows].sort((a, b) => valueAt(this.x, a) - valueAt(this.x, b) || a - b);
  }

  private updateSlider(): void {
    const order = this.order();
    const place = order.indexOf(this.marked);
    this.slider.ariaValueMin = "1";
    this.slider.ariaValueMax = String(Math.max(order.length, 1));
    this.slider.ariaValueNow = String(place < 0 ? 1 : place + 1);
    this.slider.ariaValueText = this.marked < 0 ? "no design is selected; use the arrow keys" : describe(this.designs, this.marked);
  }

  private listen(): void {
    const { box } = this.layers;
    box.addEventListener("pointermove", (event) => {
      const row = this.nearest(...this.layers.place(event));
      if (row >= 0 && row !== this.marked) this.mark(row);
    });
    box.addEventListener("click", (event) => {
      const row = this.nearest(...this.layers.place(event));
      if (row >= 0) {
        this.mark(row);
        this.choose(row);
      }
    });
    this.slider.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const order = this.order();
      const place = order.indexOf(this.marked);
      const steps: Record<string, number> = {
        ArrowRight: place + 1, ArrowUp: place + 1, ArrowLeft: Math.max(place, 1) - 1, ArrowDown: Math.max(place, 1) - 1,
        PageUp: place + 10, PageDown: place - 10, Home: 0, End: order.length - 1,
      };
      if (event.key === "Enter" && this.marked >= 0) this.choose(this.marked);
      else if (event.key in steps && order.length) this.mark(order[Math.min(Math.max(steps[event.key]!, 0), order.length - 1)]!);
      else return;
      event.preventDefault();
    });
    this.updateSlider();
  }

  private nearest(x: number, y: number): number {
    let best = -1;
    let least = HIGHLIGHT_RADIUS_PX;
    for (let row = 0; row < this.designs.names.length; row++) {
      if (this.kept && !this.kept[row]) continue;
      const away = Math.hypot(this.places[2 * row]! - x, this.places[2 * row + 1]! - y) * (this.front.has(row) ? FRONT_DISTANCE_FACTOR : 1);
      if (away < least) [best, least] = [row, away];
    }
    return best;
  }

  private draw(): void {
    const { layers, designs, x, y } = this;
    const context = layers.clear(0);
    const [x0, x1] = range(designs, x, this.whole.checked);
    const [y0, y1] = range(designs, y, this.whole.checked);
    const right = layers.width - MARGIN_PX.right;
    const bottom = layers.height - MARGIN_PX.bottom;
    const across = (value: number): number => MARGIN_PX.left + ((value - x0) / (x1 - x0)) * (right - MARGIN_PX.left);
    const up = (value: number): number => bottom - ((value - y0) / (y1 - y0)) * (bottom - MARGIN_PX.top);
    this.axes(context, { across, up, right, bottom, ends: [x0, x1, y0, y1] });
    let beyond = 0;
    const size = designs.names.length > 2000 ? 3 : 4;
    const inside = (a: number, b: number): boolean => a >= x0 && a <= x1 && b >= y0 && b <= y1;
    context.fillStyle = css("--muted");
    for (let row = 0; row < designs.names.length; row++) {
      const [a, b] = [valueAt(x, row), valueAt(y, row)];
      const seen = inside(a, b);
      beyond += Number(!seen);
      this.places[2 * row] = seen ? across(a) : NaN;
      this.places[2 * row + 1] = seen ? up(b) : NaN;
      if (!seen) continue;
      context.globalAlpha = this.kept && !this.kept[row] ? 0.08 : 0.45;
      context.fillRect(across(a) - size / 2, up(b) - size / 2, size, size);
    }
    this.beyond.textContent = beyond ? `${beyond} of ${designs.names.length} designs lie beyond these axes.` : "";
    this.special(context, across, up, inside);
    context.globalAlpha = 1;
    this.drawOverlay();
  }

  private special(
    context: CanvasRenderingContext2D, across: (a: number) => number, up: (b: number) => number, inside: (a: number, b: number) => boolean,
  ): void {
    context.fillStyle = css("--accent");
    for (const row of this.designs.front) {
      context.globalAlpha = this.kept && !this.kept[row] ? 0.2 : 1;
      dot(context, this.places[2 * row]!, this.places[2 * row + 1]!, 4);
    }
    context.globalAlpha = 1;
    context.textAlign = "left";
    const { base: a } = this.x;
    const { base: b } = this.y;
    if (a !== null && b !== null && inside(a, b)) {
      context.save();
      context.fillStyle = css("--warn");
      context.strokeStyle = css("--warn");
      context.translate(across(a), up(b));
      this.label(context, across(a), up(b));
      context.rotate(Math.PI / 4);
      context.lineWidth = 2;
      if (this.designs.remark) context.strokeRect(-5, -5, 10, 10);
      else context.fillRect(-5, -5, 10, 10);
      context.restore();
    }
    context.font = `bold ${context.font}`;
    context.lineWidth = 3;
    context.strokeStyle = css("--panel");
    context.fillStyle = css("--text");
    const taken: [number, number][] = [];
    this.designs.picks.forEach(({ row }, k) => {
      const [x, y] = [this.places[2 * row]!, this.places[2 * row + 1]!];
      const around = LABEL_OFFSETS_PX.map(([dx, dy]): [number, number] => [x + dx, y + dy]);
      const free = around.find(([a, b]) => taken.every(([c, d]) => Math.abs(a - c) > 11 || Math.abs(b - d) > 13));
      const [px, py] = free ?? around[0]!;
      taken.push([px, py]);
      context.strokeText(String(k + 1), px, py);
      context.fillText(String(k + 1), px, py);
    });
  }

  /** Label the base device's diamond at (x, y), the origin of `context`, on the side with enough room. */
  private label(context: CanvasRenderingContext2D, x: number, y: number): void {
    const name = nameBase(this.designs);
    const left = x + 10 + context.measureText(name).width > this.layers.width - MARGIN_PX.right;
    context.textAlign = left ? "right" : "left";
    context.fillText(name, left ? -10 : 10, y - 6 - LETTER_HEIGHT_PX < MARGIN_PX.top ? 6 + LETTER_HEIGHT_PX : -6);
    context.textAlign = "left";
  }

  private axes(
    context: CanvasRenderingContext2D,
    at: { across: (a: number) => number; up: (b: number) => number; right: number; bottom: number; ends: [number, number, number, number] },
  ): void {
    const [x0, x1, y0, y1] = at.ends;
    context.strokeStyle = css("--line");
    context.fillStyle = css("--muted");
    context.lineWidth = 1;
    const line = (ax: number, ay: number, bx: number, by: number): void => {
      context.beginPath();
      context.moveTo(ax, ay);
      context.lineTo(bx, by);
      context.stroke();
    };
    context.textAlign = "center";
    for (const [value, text] of marks(this.x, x0, x1, (at.right - MARGIN_PX.left) / 70)) {
      line(at.across(value), MARGIN_PX.top, at.across(value), at.bottom);
      context.fillText(text, at.across(value), at.bottom + 18);
    }
    context.textAlign = "right";
    for (const [value, text] of marks(this.y, y0, y1, (at.bottom - MARGIN_PX.top) / 60)) {
      line(MARGIN_PX.left, at.up(value), at.right, at.up(value));
      context.fillText(text, MARGIN_PX.left - 8, at.up(value) + 4, MARGIN_PX.left - 22);
    }
    context.fillStyle = css("--text");
    context.textAlign = "center";
    context.fillText(describeBetter(this.x, "→", "←"), (MARGIN_PX.left + at.right) / 2, at.bottom + 38, at.right - MARGIN_PX.left);
    context.save();
    context.translate(14, (MARGIN_PX.top + at.bottom) / 2);
    context.rotate(-Math.PI / 2);
    context.fillText(describeBetter(this.y, "→", "←"), 0, 0, at.bottom - MARGIN_PX.top);
    context.restore();
  }

  /** Draw rings around the highlighted and the chosen design. */
  private drawOverlay(): void {
    const context = this.layers.clear(1);
    for (const [row, colour, size] of [[this.chosen, css("--good"), 11], [this.marked, css("--text"), 8]] as const) {
      if (row < 0) continue;
      context.strokeStyle = colour;
      context.lineWidth = 2.5;
      context.beginPath();
      context.arc(this.places[2 * row]!, this.places[2 * row + 1]!, size, 0, 2 * Math.PI);
      context.stroke();
    }
  }
}

/** Axis title with an arrow in the direction of better values. */
function describeBetter(column: Column, right: string, left: string): string {
  const title = titleOf(column);
  return column.sense > 0 ? `${title} ${right} better` : column.sense < 0 ? `better ${left} ${title}` : title;
}

function dot(context: CanvasRenderingContext2D, x: number, y: number, radius: number): void {
  if (!Number.isFinite(x + y)) return;
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fill();
}
