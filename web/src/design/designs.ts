// The designs that a report or the chooser shows, and how their numbers are written.

export interface Column {
  /** as people read it */
  title: string;
  /** with its prefix; the values are in it */
  unit: string;
  kind: "parameter" | "objective" | "constraint";
  /** 1: to be made great; −1: to be made small; 0: neither */
  sense: number;
  /** of a choice, whose values are places in this list */
  labels: string[] | null;
  values: (number | null)[];
  base: number | null;
}

export interface Designs {
  title: string;
  /** what the designs are compared with */
  base: string;
  /** how the forces of the base device are computed, if not as those of the designs; else empty */
  remark: string;
  /** what each design is called */
  names: string[];
  columns: Column[];
  /** rows of the Pareto front */
  front: number[];
  /** designs that were chosen to be looked at */
  picks: { row: number; reason: string }[];
}

/** The base device's name, with the mark of its remark. */
export const nameBase = ({ base, remark }: Designs): string => (remark ? `${base} *` : base);

/** The value of a column in one row, as a number; NaN where there is none. */
export const valueAt = (column: Column, row: number): number => column.values[row] ?? NaN;

/** A number as people read it: four digits, a true minus. */
export function number(value: number): string {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const text = size >= 1e5 || (size > 0 && size < 1e-3) ? value.toExponential(2) : String(Number(value.toPrecision(4)));
  return text.replace("-", "−").replace("e+", "e");
}

/** A value of a column with its unit. */
export function formatValue(column: Column, value: number | null): string {
  if (value === null || !Number.isFinite(value)) return "unknown";
  return column.labels ? (column.labels[value] ?? "unknown") : `${number(value)} ${column.unit}`.trim();
}

/** Title and unit, as an axis has it. */
export const titleOf = ({ title, unit }: Column): string => (unit ? `${title} [${unit}]` : title);

/** One line on a design: its name, why it was picked, its objectives, or the first `most` of them. */
export function describe(designs: Designs, row: number, most = Infinity): string {
  const pick = designs.picks.findIndex((one) => one.row === row);
  const why = pick < 0 ? (designs.front.includes(row) ? " (on the front)" : "") : ` (no. ${pick + 1}: ${designs.picks[pick]!.reason})`;
  const goals = designs.columns.filter(({ kind }) => kind === "objective").slice(0, most);
  return `${designs.names[row]}${why}: ${goals.map((one) => `${one.title} ${formatValue(one, valueAt(one, row))}`).join(", ")}`;
}

/**
 * From where to where a column is drawn: of an objective the front, the base, and what most designs come to, so that
 * a few designs that hardly work do not press all others together.
 */
export function range(designs: Designs, column: Column, whole: boolean): [number, number] {
  const known = column.values.filter((value) => value !== null && Number.isFinite(value)).sort((a, b) => a! - b!) as number[];
  if (!known.length) return [0, 1];
  const at = (share: number): number => known[Math.round(share * (known.length - 1))]!;
  let [low, high] = [known[0]!, known.at(-1)!];
  const base = column.base !== null && !column.labels ? [column.base] : [];
  if (column.kind === "objective" && !whole) {
    const kept = [...designs.front.map((row) => valueAt(column, row)), ...base].filter(Number.isFinite);
    if (column.sense < 0) high = Math.max(at(0.9), ...kept);
    else low = Math.min(at(0.1), ...kept);
  }
  [low, high] = [Math.min(low, ...base), Math.max(high, ...base)];
  const room = column.labels ? 0.5 : 0.04 * (high - low || Math.abs(high) || 1);
  return [low - room, high + room];
}

/** Round numbers within a range, about `count` of them. */
export function ticks(low: number, high: number, count: number): number[] {
  const rough = (high - low) / Math.max(count, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= rough)!;
  const found: number[] = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
  return found;
}

/** The ticks of a column, and what stands at them. */
export function marks(column: Column, low: number, high: number, count: number): [number, string][] {
  if (column.labels) return column.labels.map((label, place) => [place, label]);
  return ticks(low, high, count).map((value) => [value, number(Number(value.toPrecision(10)))]);
}
