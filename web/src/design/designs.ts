// Designs of a report or of the chooser, and formatting of their values.

export interface Column {
  /** name for display */
  title: string;
  /** unit of the values, with prefix */
  unit: string;
  kind: "parameter" | "objective" | "constraint";
  /** 1: maximised; −1: minimised; 0: neither */
  sense: number;
  /** options of a choice, whose values are indices of this list */
  labels: string[] | null;
  values: (number | null)[];
  base: number | null;
}

export interface Designs {
  title: string;
  /** name of the base device, to which designs are compared */
  base: string;
  /** how the base device's forces are computed, if not as those of the designs; otherwise empty */
  remark: string;
  /** name of each design */
  names: string[];
  columns: Column[];
  /** rows of the Pareto front */
  front: number[];
  /** recommended designs */
  picks: { row: number; reason: string }[];
}

/** Name of the base device, with an asterisk if there is a remark on it. */
export const nameBase = ({ base, remark }: Designs): string => (remark ? `${base} *` : base);

/** Value of a column in one row; NaN: none. */
export const valueAt = (column: Column, row: number): number => column.values[row] ?? NaN;

/** Format a number with four significant digits and a minus sign (U+2212). */
export function formatNumber(value: number): string {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const text = size >= 1e5 || (size > 0 && size < 1e-3) ? value.toExponential(2) : String(Number(value.toPrecision(4)));
  return text.replace("-", "−").replace("e+", "e");
}

/** Format a value of a column with its unit. */
export function formatValue(column: Column, value: number | null): string {
  if (value === null || !Number.isFinite(value)) return "unknown";
  return column.labels ? (column.labels[value] ?? "unknown") : `${formatNumber(value)} ${column.unit}`.trim();
}

/** Axis title with unit. */
export const titleOf = ({ title, unit }: Column): string => (unit ? `${title} [${unit}]` : title);

/** Describe a design in one line: name, reason of the recommendation, first `most` objectives. */
export function describe(designs: Designs, row: number, most = Infinity): string {
  const pick = designs.picks.findIndex((one) => one.row === row);
  const why = pick < 0 ? (designs.front.includes(row) ? " (on the front)" : "") : ` (no. ${pick + 1}: ${designs.picks[pick]!.reason})`;
  const goals = designs.columns.filter(({ kind }) => kind === "objective").slice(0, most);
  return `${designs.names[row]}${why}: ${goals.map((one) => `${one.title} ${formatValue(one, valueAt(one, row))}`).join(", ")}`;
}

/**
 * Axis range of a column. For an objective it covers the front, the base device and 90 % of the designs, so that a few
 * outliers do not compress the rest; `whole`: all designs.
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

/** About `count` round numbers within a range. */
export function ticks(low: number, high: number, count: number): number[] {
  const rough = (high - low) / Math.max(count, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= rough)!;
  const found: number[] = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
  return found;
}

/** Ticks of a column with their labels. */
export function marks(column: Column, low: number, high: number, count: number): [number, string][] {
  if (column.labels) return column.labels.map((label, place) => [place, label]);
  return ticks(low, high, count).map((value) => [value, formatNumber(Number(value.toPrecision(10)))]);
}
