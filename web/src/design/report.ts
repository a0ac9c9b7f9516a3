// The page of `haptorb design report`: what moves in it. Everything else on the page is there without this.

import { at } from "../panels/dom";
import type { Designs } from "./designs";
import { Numbers } from "./numbers";
import { Parallel } from "./parallel";
import { Scatter } from "./scatter";

declare global {
  interface Window {
    /** for tests: the design that is pointed at, and that everything is drawn */
    report: { marked: number; ready: boolean };
  }
}

const designs = JSON.parse(at("designs").textContent!) as Designs;
window.report = { marked: -1, ready: false };

if (designs.names.length) {
  const numbers = new Numbers(designs);
  const mark = (row: number): void => {
    window.report.marked = row;
    scatter.show(row);
    parallel.show(row);
    numbers.show(row);
  };
  const scatter = new Scatter(designs, mark, (row) => {
    scatter.take(row);
    const pick = designs.picks.findIndex((one) => one.row === row);
    if (pick >= 0) at(`best-${pick + 1}`).scrollIntoView();
  });
  const parallel = new Parallel(designs, mark, (kept) => scatter.filter(kept));
  at("scatter").append(scatter.root, numbers.root);
  at("parallel").append(parallel.root);
  if (designs.picks.length) mark(designs.picks[0]!.row);
}
requestAnimationFrame(() => requestAnimationFrame(() => (window.report.ready = true)));
