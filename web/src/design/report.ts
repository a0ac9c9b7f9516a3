// Interactive plots in the page of `haptorb design report`; the rest of the page works without this script.

import { at } from "../panels/dom";
import type { Designs } from "./designs";
import { Numbers } from "./numbers";
import { Parallel } from "./parallel";
import { Scatter } from "./scatter";

declare global {
  interface Window {
    /** for tests: row of the highlighted design, and whether drawing is complete */
    report: { marked: number; readonly ready: boolean };
  }
}

const designs = JSON.parse(at("designs").textContent!) as Designs;
let drawn = (): boolean => true;
window.report = {
  marked: -1,
  get ready() {
    return drawn();
  },
};

if (designs.names.length) {
  const numbers = new Numbers(designs);
  const mark = (row: number): void => {
    window.report.marked = row;
    scatter.show(row);
    parallel.show(row);
    numbers.show(row);
  };
  const scatter = new Scatter(designs, mark, (row) => {
    scatter.setChosen(row);
    const pick = designs.picks.findIndex((one) => one.row === row);
    if (pick >= 0) at(`best-${pick + 1}`).scrollIntoView();
  });
  const parallel = new Parallel(designs, mark, (kept) => scatter.filter(kept));
  at("scatter").append(scatter.root, numbers.root);
  at("parallel").append(parallel.root);
  drawn = () => parallel.drawn;
  if (designs.picks.length) mark(designs.picks[0]!.row);
}
