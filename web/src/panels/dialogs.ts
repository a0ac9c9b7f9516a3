// Dialogs: keys and mouse, and data of the device.

import type { DeviceScene } from "../scene/device_scene";
import type { Scene, Session } from "../session";
import { at, make } from "./dom";

const FEEL = [
  ["1 to 7", "rate the current design"],
  ["A, B", "feel the design in slot A or B"],
  ["N", "next design in random order"],
] as const;

const PAUSE = [["P", "pause the plots; mark a range or use the wheel to zoom"]] as const;
const ZOOM = [["plots", "mark a range or use the wheel to zoom"]] as const;

type Keys = readonly (readonly [string, string])[];

const STOP: Keys = [["Space, Esc", "STOP: coils off at once, from anywhere in the page"]];

/** Fill both dialogs. `keys`: keys that move the mover; `first`: entries before them. */
export function fillDialogs(session: Session, scene: DeviceScene, keys: Keys, first = STOP): void {
  const all = [
    ...first,
    ...keys,
    ...(session.feel ? FEEL : []),
    [`drag beside the ${scene.held}`, "turn the view; wheel or pinch zooms; 0 resets"],
    ...(first === STOP ? PAUSE : ZOOM),
    ["Tab, Enter", "move to and press any button"],
    ["?", "this help"],
  ] as const;
  at("keys").append(...all.flatMap(([key, what]) => [make("dt", {}, key), make("dd", {}, what)]));

  const { device, limits, coils } = session;
  const { gives } = session.scene;
  at("details-title").textContent = device.title;
  const facts: [string, string][] = [
    ["source", device.source],
    ["driver", session.simulated ? "simulated: device, tool and hand are computed" : "hardware"],
    [`${gives} limit`, `${limits[gives]} ${gives === "torque" ? "N·m" : "N"}`],
    ["current limit", new Set(limits.current).size === 1 ? `${limits.current[0]} A in each of ${coils.length}` : coils.map((name, i) => `${name} ${limits.current[i]!.toFixed(0)} A`).join(", ")],
    ["winding", `warm ${limits.warn.toFixed(0)}, derated ${limits.derate.toFixed(0)}, off ${limits.stop.toFixed(0)} °C`],
    ...sizes(session.scene),
    ["a pose expires", `after ${(1000 * limits.expiry).toFixed(0)} ms`],
    ["haptorb", session.version],
  ];
  at("facts").append(...facts.flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]));

  open("ask", "help", "details");
  open("device", "details", "help");
  // Esc stops and also closes the dialog: browsers close only modal dialogs themselves.
  const close = (event: KeyboardEvent): void => {
    if (event.key === "Escape") for (const id of ["help", "details"]) at<HTMLDialogElement>(id).close();
  };
  addEventListener("keydown", close, { capture: true });
}

/** Keep an open dialog below the alert, which may appear at any time. */
export function placeDialogBelowAlert(): void {
  const dialog = document.querySelector<HTMLElement>("dialog[open]");
  if (!dialog) return;
  const alert = at("alert");
  const page = document.querySelector(".page")!.getBoundingClientRect();
  const edge = alert.hidden ? 0 : Math.max(0, alert.getBoundingClientRect().bottom - page.top + 8);
  dialog.style.setProperty("--alert", `${Math.min(edge, page.height - 120).toFixed(0)}px`);
}

/** Sizes of the coils in the device file, and notes on the sizes that it omits. */
function sizes({ parts = [], notes = [] }: Scene): [string, string][] {
  const millimetres = (length: number): string => `${+(1000 * length).toFixed(2)}`;
  const coils = new Map<string, string[]>();
  for (const coil of parts.filter(({ role, stated }) => role === "coil" && stated)) {
    const size = `radii ${millimetres(coil.inner_radius)} to ${millimetres(coil.outer_radius)} mm, ${millimetres(coil.length)} mm long`;
    coils.set(size, [...(coils.get(size) ?? []), coil.name]);
  }
  const rows = [...coils].map(([size, names]): [string, string] => {
    const some = names.length > 6 ? [names[0], "…", names.at(-1)] : names;
    return [`coil${names.length > 1 ? "s" : ""} ${some.join(" ")}`, size];
  });
  return [...rows, ...notes.map((note): [string, string] => ["drawing", note])];
}

/** Open `dialog` with `button`, and close the other; not modal, because STOP must work beside it. */
function open(button: string, dialog: string, other: string): void {
  at(button).addEventListener("click", () => {
    at<HTMLDialogElement>(other).close();
    at<HTMLDialogElement>(dialog).show();
  });
}
