// Three plots of the last seconds with a common time axis; commanded values are dashed, delivered ones solid.

import uPlot from "uplot";
import { csv, download } from "../csv";
import type { History } from "../history";
import type { DeviceScene } from "../scene/device_scene";
import type { Session } from "../session";
import { channelColour, css, onThemeChange } from "../theme";
import { at, make, formatNumber, write } from "./dom";
import { Envelope } from "./envelope";

const ZERO_CELSIUS_K = 273.15;

interface Curve {
  label: string;
  colour: string;
  dashed?: boolean;
  /** indices of the history's series, and the value computed from them */
  from: number[];
  make: (columns: Float32Array[], i: number) => number;
}

interface Plot {
  chart: uPlot;
  curves: Curve[];
  reading: HTMLElement;
  digits: number;
}

const identity: Curve["make"] = ([x], i) => x![i]!;
const magnitude: Curve["make"] = ([x, y, z], i) => Math.sqrt(x![i]! ** 2 + y![i]! ** 2 + z![i]! ** 2);
const radial: Curve["make"] = (of, i) => {
  const [x, y, z] = [of[3]![i]!, of[4]![i]!, of[5]![i]!];
  return (of[0]![i]! * x + of[1]![i]! * y + of[2]![i]! * z) / Math.sqrt(x * x + y * y + z * z);
};

export class Plots {
  private readonly plots: Plot[] = [];
  private readonly select = make("select", {});
  private held: { from: number; to: number } | null = null;
  private zoomed: { from: number; to: number } | null = null;
  private span = 10;
  /** whether a redraw is due, and time of the last one [ms] */
  private stale = true;
  private drawn = -Infinity;
  /** minimum interval between redraws [ms] */
  interval = 66;
  private readonly envelope = new Envelope();
  private live = true;
  private shown: [number, number] = [0, 0];
  private readonly sync = uPlot.sync("time");

  constructor(
    private readonly history: History,
    private readonly session: Session,
    scene: DeviceScene,
  ) {
    this.select.ariaLabel = `Which part of the ${session.scene.gives}`;
    this.select.append(make("option", { value: "magnitude" }, "magnitude"));
    if (scene.radial) this.select.append(make("option", { value: "radial" }, "radial"));
    this.select.append(make("option", { value: "xyz" }, "x y z"));
    if (scene.radial) this.select.append(make("option", { value: "torque" }, "torque"));
    this.select.addEventListener("change", () => this.build());
    at("pause").addEventListener("click", () => this.pause(!this.held));
    at("unzoom").addEventListener("click", () => this.unzoom());
    at("export").addEventListener("click", () => this.export());
    at<HTMLSelectElement>("span").addEventListener("change", (event) => {
      this.span = Number((event.target as HTMLSelectElement).value);
      this.unzoom();
    });
    onThemeChange(() => this.build());
    new ResizeObserver(() => this.resize()).observe(at("plots"));
    this.build();
  }

  /** Whether torque is plotted instead of force. */
  private get turning(): boolean {
    return this.session.scene.gives === "torque" || this.select.value === "torque";
  }

  get paused(): boolean {
    return this.held !== null;
  }

  pause(yes: boolean): void {
    this.held = yes ? { from: this.history.newest - this.span, to: this.history.newest } : null;
    if (!yes) this.zoomed = null;
    const button = at("pause");
    button.setAttribute("aria-pressed", String(yes));
    write(button, yes ? "▶ resume" : "‖ pause");
    this.invalidate();
  }

  /** Show the last plots in grey while the page is not live. */
  freeze(dead: boolean): void {
    this.live = !dead;
    document.querySelector(".plots")!.classList.toggle("dead", dead);
    if (dead) for (const { reading } of this.plots) write(reading, "not live");
  }

  /** Redraw the plots if a redraw is due; returns whether it did.
   *
   * All plots are redrawn in the same frame: without a GPU, browsers repaint the bounding box of all changed areas, which
   * is most of the page as soon as one plot changes. */
  draw(now: number, fresh: boolean): boolean {
    if (fresh && !this.held) this.invalidate();
    if (!this.stale || now - this.drawn < this.interval) return false;
    this.stale = false;
    this.drawn = now;
    this.plots.forEach((plot) => this.redraw(plot));
    return true;
  }

  private invalidate(): void {
    this.stale = true;
  }

  private get window(): { from: number; to: number } {
    if (this.zoomed) return this.zoomed;
    return this.held ?? { from: this.history.newest - this.span, to: this.history.newest };
  }

  private redraw(plot: Plot): void {
    const { from, to } = this.window;
    if (!Number.isFinite(to)) return;
    const [first, last] = this.history.window(from, to);
    this.shown = [first, last];
    const { chart, curves } = plot;
    this.envelope.layOut(this.history.times(first, last), from, to, chart.bbox.width);
    const series = curves.map(({ from: indices, make: compose }) => {
      const columns = indices.map((index) => this.history.column(index, first, last));
      return this.envelope.of((i) => compose(columns, i));
    });
    chart.batch(() => {
      chart.setData([this.envelope.times, ...series] as uPlot.AlignedData, false);
      chart.setScale("x", { min: from, max: to });
    });
    this.read(plot);
  }

  /** Axis ticks at round times before the newest sample. */
  private splits(from: number, to: number, most: number): number[] {
    const end = this.held?.to ?? this.window.to;
    const step = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5].find((s) => (to - from) / s <= most) ?? 10;
    const ticks: number[] = [];
    for (let k = Math.ceil((from - end) / step); end + k * step <= to + 1e-9; k++) ticks.push(end + k * step);
    return ticks;
  }

  /** Show the values at the cursor, or the newest ones. */
  private read({ chart, curves, reading, digits }: Plot): void {
    if (!this.live) return;
    const { idx, left } = chart.cursor;
    const pointed = idx != null && left != null && left >= 0;
    const [begin, end] = this.history.window(-Infinity, pointed ? chart.posToVal(left, "x") : this.window.to);
    if (end <= begin) return write(reading, "");
    const values = curves.map(({ from, make: compose }) => compose(from.map((index) => this.history.column(index, end - 1, end)), 0));
    const when = pointed ? `${formatNumber(this.history.times(end - 1, end)[0]! - this.history.newest, 3)} s  ` : "";
    // With many channels there is room only for the largest; the table shows all.
    const all = curves.map((_, c) => c);
    const size = (c: number): number => Math.abs(values[c]!) || 0;
    const few = curves.length <= 6 ? all : all.sort((a, b) => size(b) - size(a)).slice(0, 3);
    const parts = few.map((c) => `${curves[c]!.label} ${formatNumber(values[c]!, digits)}`);
    if (few.length < curves.length) parts.unshift("largest");
    write(reading, when + parts.join("  "));
  }

  private unzoom(): void {
    this.zoomed = null;
    if (this.held) this.held = { from: this.held.to - this.span, to: this.held.to };
    this.invalidate();
  }

  private export(): void {
    const { from, to } = this.window;
    const [first, last] = this.history.window(from, to);
    const name = `haptorb-${this.session.device.name}-${new Date().toISOString().replaceAll(/[:.]/g, "-")}.csv`;
    download(csv(this.history, first, last), name);
  }

  private index(name: string): number {
    const i = this.history.series.findIndex((series) => series.name === name);
    if (i < 0) throw new Error(`no series '${name}'`);
    return i;
  }

  private force(): Curve[] {
    const axes = [0, 1, 2] as const;
    const first = this.turning ? 3 : 0;
    const of = (name: string): number[] => axes.map((i) => this.index(`${name}[${first + i}]`));
    const position = axes.map((i) => this.index(`p[${i}]`));
    const pair = (name: string, label: string, colour: string, dashed: boolean): Curve =>
      this.select.value === "radial"
        ? { label, colour, dashed, from: [...of(name), ...position], make: radial }
        : { label, colour, dashed, from: of(name), make: magnitude };
    // read as: delivered 0.30 of 0.31
    if (this.select.value !== "xyz") return [pair("wrench_actual", "delivered", "--delivered", false), pair("wrench_commanded", "of", "--commanded", true)];
    return axes.flatMap((i) => [
      { label: "xyz"[i]!, colour: `--s${"xyz"[i]!}`, from: [this.index(`wrench_actual[${first + i}]`)], make: identity },
      { label: "", colour: `--s${"xyz"[i]!}`, dashed: true, from: [this.index(`wrench_commanded[${first + i}]`)], make: identity },
    ]);
  }

  private perCoil(name: string, change: Curve["make"]): Curve[] {
    return this.session.coils.map((coil, i) => ({
      label: coil,
      colour: channelColour(i, this.session.coils.length),
      from: [this.index(this.session.coils.length > 1 ? `${name}[${i}]` : name)],
      make: change,
    }));
  }

  private build(): void {
    for (const { chart } of this.plots.splice(0)) chart.destroy();
    at("plots").replaceChildren();
    const { warn, derate } = this.session.limits;
    const strong = this.session.scene.gives === "torque";
    const small = this.turning && !strong; // torque on a tool: some mN·m
    this.add(this.turning ? "torque N·m" : "force N", this.force(), small ? 4 : strong ? 3 : 2, small ? 0.002 : 0.2, this.select);
    this.add("currents A", this.perCoil("current_measured", identity), 2, strong ? 0.2 : 1);
    this.add("temperature °C", this.perCoil("winding", ([x], i) => x![i]! - ZERO_CELSIUS_K), 1, 5, undefined, { warn, derate });
    this.invalidate();
  }

  private add(
    title: string,
    curves: Curve[],
    digits: number,
    least: number,
    control?: HTMLElement,
    limit?: { warn: number; derate: number },
  ): void {
    const reading = make("span", { className: "reading" });
    const canvas = make("div", { className: "canvas" });
    const heading = make("div", { className: "title" }, make("b", {}, title), ...(control ? [control] : []), reading);
    const box = make("div", { className: "plot" }, heading, canvas);
    at("plots").append(box);
    const text = css("--muted");
    const axis = { stroke: text, font: `14px ${css("--font")}`, grid: { stroke: css("--line"), width: 1 }, ticks: { show: false } };
    const chart = new uPlot(
      {
        width: Math.max(50, canvas.clientWidth),
        height: Math.max(50, canvas.clientHeight),
        padding: [8, 20, 0, 0],
        legend: { show: false },
        cursor: { sync: { key: "time" }, drag: { x: true, y: false, setScale: false }, points: { size: 6 } },
        scales: {
          x: { time: false, auto: false },
          y: { range: (_, low, high) => padRange(low, high, least, limit?.derate) },
        },
        axes: [
          { ...axis, size: 24, splits: (self, _, from, to) => this.splits(from, to, self.width / 70), values: (_, ticks) => ticks.map((t) => formatTick(t - (this.held?.to ?? this.window.to))) , space: 60 },
          { ...axis, size: 52, values: (_, ticks) => ticks.map((y) => String(Number(y.toFixed(4))).replace("-", "−")), space: 30 },
        ],
        series: [
          {},
          ...curves.map(({ label, colour, dashed }) => ({
            label,
            stroke: colour.startsWith("--") ? css(colour) : colour,
            width: dashed ? 1.25 : 1.75,
            points: { show: false },
            ...(dashed ? { dash: [6, 4] } : {}),
          })),
        ],
        hooks: {
          setCursor: [(self: uPlot) => this.plots.filter(({ chart: c }) => c === self).forEach((plot) => this.read(plot))],
          setSelect: [(self: uPlot) => this.zoom(self)],
          draw: limit ? [(self: uPlot) => drawLimits(self, limit)] : [],
        },
      },
      [[], ...curves.map(() => [])],
      canvas,
    );
    chart.over.addEventListener("dblclick", () => this.unzoom());
    chart.over.addEventListener("wheel", (event) => this.wheel(chart, event), { passive: false });
    this.sync.sub(chart);
    this.plots.push({ chart, curves, reading, digits });
  }

  /** Pause, and zoom to the selected range. */
  private zoom(chart: uPlot): void {
    const { left, width } = chart.select;
    if (width < 4) return;
    const from = chart.posToVal(left, "x");
    const to = chart.posToVal(left + width, "x");
    chart.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    if (!this.held) this.pause(true);
    this.zoomed = { from, to };
    this.invalidate();
  }

  private wheel(chart: uPlot, event: WheelEvent): void {
    event.preventDefault();
    if (!this.held) this.pause(true);
    const { from, to } = this.window;
    const around = chart.posToVal(event.offsetX, "x");
    const factor = Math.exp(event.deltaY * 0.002);
    const whole = this.held!;
    this.zoomed = {
      from: Math.max(whole.from, around + (from - around) * factor),
      to: Math.min(whole.to, around + (to - around) * factor),
    };
    if (this.zoomed.to - this.zoomed.from < 0.005) this.zoomed = { from, to };
    this.invalidate();
  }

  private resize(): void {
    for (const { chart } of this.plots) {
      const box = chart.root.parentElement!;
      if (box.clientWidth > 0) chart.setSize({ width: box.clientWidth, height: box.clientHeight });
    }
    this.invalidate();
  }

  /** Number of samples shown, for tests. */
  get samples(): number {
    return this.shown[1] - this.shown[0];
  }
}

/** Label of a time relative to the newest sample [s]. */
function formatTick(seconds: number): string {
  const rounded = Number(seconds.toFixed(3));
  return rounded === 0 ? "now" : `${rounded} s`.replace("-", "−");
}

/** Axis range of at least `least`, so that noise does not rescale it, and including `limit`. */
function padRange(low: number, high: number, least: number, limit?: number): [number, number] {
  if (!Number.isFinite(low + high)) return [0, least];
  let a = Math.min(low, high);
  let b = Math.max(low, high);
  if (limit !== undefined) b = Math.max(b, limit * 1.04);
  const spare = Math.max(least - (b - a), 0) / 2;
  a = a >= 0 && (a < 0.3 * b || limit === undefined) ? 0 : a - spare;
  b += spare;
  const margin = 0.06 * (b - a);
  return [a === 0 ? 0 : a - margin, b + margin];
}

/** Draw the warning and derating temperatures. */
function drawLimits(chart: uPlot, { warn, derate }: { warn: number; derate: number }): void {
  const { ctx, bbox } = chart;
  ctx.save();
  ctx.lineWidth = devicePixelRatio;
  ctx.font = `${14 * devicePixelRatio}px ${css("--font")}`;
  ctx.textAlign = "right";
  for (const [value, colour, word] of [
    [warn, css("--warn"), "warm"],
    [derate, css("--bad"), "derating"],
  ] as const) {
    const y = chart.valToPos(value, "y", true);
    if (y < bbox.top || y > bbox.top + bbox.height) continue;
    ctx.strokeStyle = ctx.fillStyle = colour;
    ctx.setLineDash([2 * devicePixelRatio, 4 * devicePixelRatio]);
    ctx.beginPath();
    ctx.moveTo(bbox.left, y);
    ctx.lineTo(bbox.left + bbox.width, y);
    ctx.stroke();
    ctx.fillText(word, bbox.left + bbox.width - 4 * devicePixelRatio, y + 16 * devicePixelRatio);
  }
  ctx.restore();
}
