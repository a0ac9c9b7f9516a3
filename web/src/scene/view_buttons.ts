// Buttons that rotate, zoom and reset the view.

import type { Orbit } from "./orbit";

/** Connect every `[data-view]` button of the page to `orbit`. */
export function listenToViewButtons(orbit: Orbit): void {
  const views: Record<string, () => void> = {
    left: () => orbit.turn(-15, 0),
    right: () => orbit.turn(15, 0),
    up: () => orbit.turn(0, 10),
    down: () => orbit.turn(0, -10),
    in: () => orbit.zoom(1 / 1.25),
    out: () => orbit.zoom(1.25),
    reset: () => orbit.reset(),
  };
  for (const button of document.querySelectorAll<HTMLElement>("[data-view]")) {
    button.addEventListener("click", views[button.dataset["view"]!]!);
  }
}
