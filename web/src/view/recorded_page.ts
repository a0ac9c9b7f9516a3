// Removes or disables everything in the console's document that needs a servo, with the reason.

import { at, make, write } from "../panels/dom";
import type { Recorded } from "./played";

const REASON = "A recording: controls that need a servo are disabled.";

export function hideControls({ name, notices }: Recorded): void {
  document.body.classList.add("recorded");
  document.title = `haptorb · ${name}`;
  const badge = make("p", { className: "badge recording", title: REASON }, "RECORDING");
  at("stop").before(badge);
  document.querySelector(".top")!.ariaLabel = "State";
  for (const id of ["sound", "rumble", "cool", "watching"]) at(id).remove();
  at("reset").before(make("span", { className: "about", title: REASON }, "as recorded"));
  for (const id of ["stop", "reset", "pause"]) at(id).hidden = true; // hidden, not removed: the panels still write to them
  for (const id of ["world", "model"]) at(id).title = REASON;
  at("sliders").title = REASON;
  for (const id of ["mode-translate", "mode-rotate", "mode-clutch"]) at(id).title = REASON;
  const canvas = at("scene");
  canvas.tabIndex = -1;
  canvas.role = "img";
  canvas.ariaLabel = "The device as recorded; the numbers are beside it, the timeline is below.";
  write(document.querySelector<HTMLElement>("#help > p")!, "No servo runs: nothing here moves a device.");
  at("simulated").title = "Recorded from a simulated device";
  if (notices.length) {
    const list = make("ul", { className: "notices", role: "note" }, ...notices.map((text) => make("li", {}, text)));
    document.querySelector(".notes")!.prepend(list);
  }
  const facts = at("facts");
  facts.prepend(make("dt", {}, "recording"), make("dd", {}, name));
}
