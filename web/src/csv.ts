// CSV export of a range of samples: one line per tick, with the same column heads as a recording's CSV file.

import type { History } from "./history";

export function csv(history: History, first: number, last: number): string {
  const quote = (text: string): string => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const lines = [history.series.map(({ head }) => quote(head)).join(",")];
  const times = history.times(first, last);
  const columns = history.series.map((_, c) => history.column(c, first, last));
  for (let i = 0; i < times.length; i++) {
    lines.push(columns.map((column, c) => (c === 0 ? times[i]!.toFixed(6) : short(column[i]!))).join(","));
  }
  return lines.join("\n") + "\n";
}

/** Nine significant digits represent a float32 exactly; NaN becomes an empty cell. */
function short(value: number): string {
  if (Number.isNaN(value)) return "";
  return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(9)));
}

export function download(text: string, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
