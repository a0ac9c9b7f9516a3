// Keyboard and pen buttons: stop works everywhere, all other keys only outside input fields.

import type { Plots } from "./panels/plots";
import type { Orbit } from "./scene/orbit";
import type { DeviceDrawing } from "./scene/device_drawing";
import type { HandGoal } from "./wire";

export interface KeyActions {
  stop(by: string): void;
  press(buttons: string[]): void;
  rest(handGoal: HandGoal, stamp: number): void;
  readonly drawing: DeviceDrawing;
  readonly orbit: Orbit | null;
  readonly plots: Plots;
  readonly control: boolean;
}

const ARROWS: Record<string, [number, number]> = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
};

const BUTTONS: Record<string, string> = { Digit1: "a", Digit2: "b", Digit3: "c" };

/** Pen buttons by their bit in `PointerEvent.buttons`: barrel button and eraser. */
const PEN_BUTTONS: [number, string][] = [[2, "a"], [32, "b"]];

/** Buttons of the tool for connected programs; pressed while the key or the pen's button is. */
function listenForButtons(actions: KeyActions): void {
  const down = new Set<string>();
  const sendPressed = (): void => actions.press([...down].sort());
  addEventListener("keydown", (event) => {
    const button = BUTTONS[event.code];
    if (!button || down.has(button) || event.ctrlKey || event.metaKey || event.altKey || !actions.control) return;
    if ((event.target as HTMLElement).closest("input, select, dialog[open]")) return;
    down.add(button);
    sendPressed();
  });
  const up = (released: string[]): void => {
    const before = down.size;
    released.forEach((button) => down.delete(button));
    if (down.size < before) sendPressed();
  };
  addEventListener("keyup", (event) => up([BUTTONS[event.code] ?? ""]));
  addEventListener("blur", () => up(["a", "b", "c"]));
  const held = new Set<string>(); // pressed with the pen
  const updatePenButtons = (event: PointerEvent): void => {
    if (event.pointerType !== "pen") return;
    const gone = event.type === "pointercancel" || event.type === "pointerleave";
    for (const [bit, button] of PEN_BUTTONS) {
      const pressed = !gone && (event.buttons & bit) !== 0 && actions.control;
      if (pressed === held.has(button)) continue;
      if (pressed) {
        held.add(button);
        down.add(button);
        sendPressed();
      } else {
        held.delete(button);
        up([button]);
      }
    }
  };
  for (const type of ["pointerdown", "pointermove", "pointerup", "pointercancel"] as const) addEventListener(type, updatePenButtons, { capture: true });
  document.addEventListener("pointerleave", updatePenButtons);
  // The barrel button would otherwise open the context menu.
  addEventListener("contextmenu", (event) => (event as PointerEvent).pointerType === "pen" && event.preventDefault());
}

export function listenToKeys(actions: KeyActions): void {
  listenForButtons(actions);
  addEventListener(
    "keydown",
    (event) => {
      if (event.key === " " || event.key === "Escape") {
        // In the capture phase, so that a focused button or an open list cannot intercept the stop.
        actions.stop(event.key === " " ? "Space" : "Esc");
        if (event.key === " ") event.preventDefault();
        event.stopPropagation();
      }
    },
    { capture: true },
  );
  // A focused button would otherwise be clicked when Space is released.
  addEventListener("keyup", (event) => event.key === " " && event.preventDefault(), { capture: true });

  addEventListener("keydown", (event) => {
    const target = event.target as HTMLElement;
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (target.closest("input, select, dialog[open]")) return;
    const arrow = ARROWS[event.key];
    const step = event.shiftKey ? 5 : 1;
    if (arrow && actions.control) {
      actions.rest(actions.drawing.nudge(step * arrow[0], step * arrow[1]), event.timeStamp);
    } else if ((event.key === "+" || event.key === "-" || event.key === "=") && actions.control) {
      actions.rest(actions.drawing.press(event.key === "-" ? -1 : 1), event.timeStamp);
    } else if (/^[qe]$/i.test(event.key) && actions.drawing.spin && actions.control) {
      actions.rest(actions.drawing.spin((event.key.toLowerCase() === "q" ? 2 : -2) * step), event.timeStamp);
    } else if (event.key === "0") actions.orbit?.reset();
    else if (event.key === "p" || event.key === "P") actions.plots.pause(!actions.plots.paused);
    else if (event.key === "?") document.getElementById("ask")!.click();
    else return;
    event.preventDefault();
  });
}
