// What the keys do, and what the device is.

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

/** `keys`: what they do to the device's mover; `first`: those that come before. */
export function fill(session: Session, scene: DeviceScene, keys: Keys, first = STOP): void {
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
  // Esc stops, and closes: a dialog that is not modal does not close by itself.
  const close = (event: KeyboardEvent): void => {
    if (event.key === "Escape") for (const id of ["help", "details"]) at<HTMLDialogElement>(id).close();
  };
  addEventListener("keydown", close, { capture: true });
}

/** An open dialog stays below the reason why the coils are off, which comes by itself. */
export function uncover(): void {
  const dialog = document.querySelector<HTMLElement>("dialog[open]");
  if (!dialog) return;
  const reason = at("alert");
  const page = document.querySelector(".page")!.getBoundingClientRect();
  const edge = reason.hidden ? 0 : Math.max(0, reason.getBoundingClientRect().bottom - page.top + 8);
  dialog.style.setProperty("--alert", `${Math.min(edge, page.height - 120).toFixed(0)}px`);
}

/** How large the coils of the picture are, by the device file, and what it does not state. */
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

/** Not modal: STOP must work beside it. One at a time. */
function open(button: string, dialog: string, other: string): void {
  at(button).addEventListener("click", () => {
    at<HTMLDialogElement>(other).close();
    at<HTMLDialogElement>(dialog).show();
  });
}
