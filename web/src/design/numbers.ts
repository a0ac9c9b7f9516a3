// Table of the highlighted design's values beside those of the base device.

import { make } from "../panels/dom";
import { nameBase, titleOf, valueAt, formatValue, type Column, type Designs } from "./designs";

export class Numbers {
  readonly root = make("div", { className: "numbers" });
  private readonly head = make("h3", {}, "Point at a design");
  private readonly why = make("p", { className: "soft" });
  private readonly cells: [Column, HTMLElement][] = [];

  constructor(private readonly designs: Designs) {
    const body = make("tbody");
    const kinds = { objective: "Objectives", parameter: "Parameters", constraint: "Constraints" } as const;
    for (const [kind, name] of Object.entries(kinds)) {
      const columns = designs.columns.filter((one) => one.kind === kind);
      if (columns.length) body.append(make("tr", {}, make("th", { colSpan: 3, className: "group" }, name)));
      for (const column of columns) {
        const cell = make("td", {}, "–");
        this.cells.push([column, cell]);
        const base = column.base === null ? "" : plain(column, column.base);
        body.append(make("tr", {}, make("th", { scope: "row" }, titleOf(column)), cell, make("td", { className: "soft" }, base)));
      }
    }
    const heads = make("thead", {}, make("tr", {}, make("th"), make("th", { scope: "col" }, "design"), make("th", { scope: "col" }, nameBase(designs))));
    this.root.append(this.head, this.why, make("table", {}, heads, body));
    if (designs.remark) this.root.append(make("p", { className: "soft" }, `* ${designs.remark}.`));
  }

  show(row: number): void {
    const { designs } = this;
    this.head.textContent = designs.names[row]!;
    const pick = designs.picks.findIndex((one) => one.row === row);
    this.why.textContent = pick >= 0 ? `No. ${pick + 1}: ${designs.picks[pick]!.reason}` : designs.front.includes(row) ? "On the Pareto front" : "";
    for (const [column, cell] of this.cells) cell.textContent = plain(column, valueAt(column, row));
  }
}

/** Value without its unit, which is in the row's head. */
const plain = (column: Column, value: number): string => {
  const text = formatValue(column, value);
  return column.unit && text.endsWith(` ${column.unit}`) ? text.slice(0, -column.unit.length - 1) : text;
};
