// World panel: parameters as sliders with text entry; changes take effect immediately.

import { readNumber } from "../entry";
import { direction, spherical, type Vector } from "../sample";
import type { Parameter, Session, Values, World } from "../session";
import { at, make, write, writeRemarks } from "./dom";

const SEND_INTERVAL_MS = 33; // while a slider is dragged
const SETTLING_TIME_MS = 1000; // after a change here, in which the server may still report earlier values

/** One number of the panel; a direction has two. */
interface Entry {
  id: string;
  label: string;
  unit: string;
  low: number;
  high: number;
  step: number;
  about: string;
  read(values: Values): number;
  put(values: Values, value: number): void;
}

export class WorldPanel {
  private values: Values = {};
  private name = "";
  private readonly rows = new Map<Entry, { range: HTMLInputElement; number: HTMLInputElement }>();
  private readonly picker = at<HTMLSelectElement>("world");
  private timer = 0;
  private later = 0;
  private last = 0;
  private sent = 0;
  private typing: HTMLInputElement | undefined; // field with an uncommitted entry

  constructor(
    private readonly session: Session,
    private readonly send: (name: string, values: Values) => void,
  ) {
    this.offer(session.worlds);
    this.picker.addEventListener("change", () => this.send(this.picker.value, {}));
    at("reset").addEventListener("click", () => this.reset());
    this.show(session.world.name, session.world.values);
    this.remark(session.world.remarks ?? []);
  }

  /** Show the remarks on the world with its present values. */
  remark(remarks: string[]): void {
    writeRemarks(at("remarks"), remarks);
  }

  /** Update the list of worlds; the parameters of a user's world may have changed. */
  offer(worlds: World[]): void {
    this.session.worlds = worlds;
    this.picker.replaceChildren(...worlds.map(({ name, about }) => make("option", { value: name, title: about }, name)));
    this.name = ""; // so that the next `show` rebuilds the sliders at once
    this.last = 0;
  }

  /** Show the world and its values as the server reports them. */
  show(name: string, values: Values): void {
    const isNew = name !== this.name;
    // While the user changes values, the server's are out of date; show them once the user has stopped.
    clearTimeout(this.later);
    const wait = this.last + SETTLING_TIME_MS - performance.now();
    if (!isNew && wait > 0) {
      this.later = window.setTimeout(() => this.show(name, values), wait);
      return;
    }
    this.name = name;
    this.values = structuredClone(values);
    if (!this.session.worlds.some((world) => world.name === name)) this.picker.append(make("option", { value: name }, name));
    this.picker.value = name;
    write(at("world-title"), `World: ${name}`);
    if (isNew) this.build();
    this.refresh();
  }

  enable(yes: boolean): void {
    this.picker.disabled = !yes;
    at<HTMLButtonElement>("reset").disabled = !yes;
    for (const { range, number } of this.rows.values()) range.disabled = number.disabled = !yes;
  }

  private get world(): World | undefined {
    return this.session.worlds.find((world) => world.name === this.name);
  }

  private reset(): void {
    for (const { name, default: value } of this.world?.parameters ?? []) this.values[name] = structuredClone(value);
    this.refresh();
    this.push();
  }

  private build(): void {
    this.rows.clear();
    const form = at("sliders");
    form.replaceChildren();
    form.onsubmit = (event) => event.preventDefault();
    write(at("about"), this.world?.about ?? "");
    for (const parameter of this.world?.parameters ?? []) {
      for (const entry of entries(parameter)) form.append(this.row(entry));
    }
  }

  private row(entry: Entry): HTMLElement {
    const { id, label, unit, low, high, step, about } = entry;
    const limits = { min: String(low), max: String(high) };
    const range = make("input", { type: "range", ...limits, step: String(step) });
    // Type text, because a field of type number drops letters while typing: 1a9 would become 19.
    const number = make("input", { type: "text", inputMode: "decimal", autocomplete: "off", className: "number", id });
    number.setAttribute("aria-describedby", `${id}-mistake`);
    const mistake = make("p", { className: "refused", id: `${id}-mistake`, hidden: true });
    mistake.setAttribute("role", "alert");
    const setMistake = (text: string): void => {
      write(mistake, text);
      mistake.hidden = text === "";
      number.setAttribute("aria-invalid", String(text !== ""));
    };
    range.setAttribute("aria-label", label);
    range.setAttribute("aria-description", about);
    const changed = (value: number): void => {
      setMistake("");
      entry.put(this.values, value);
      this.refresh(number);
      this.push();
    };
    range.addEventListener("input", () => changed(range.valueAsNumber));
    number.addEventListener("input", () => {
      this.typing = number;
      setMistake("");
    });
    number.addEventListener("change", () => {
      const typed = number.value;
      const value = readNumber(typed);
      this.typing = undefined;
      if (value !== null && value >= low && value <= high) changed(value);
      else setMistake(`“${typed}” is not used: a number from ${short(low)} to ${short(high)}${unit && ` ${unit}`}. ${label} stays ${short(entry.read(this.values))}.`);
      this.refresh();
    });
    number.addEventListener("blur", () => {
      this.typing = undefined;
      this.refresh();
    });
    const row = make(
      "div",
      { className: "slider" },
      make("label", { htmlFor: id, title: about }, label),
      make("span", { className: "entry" }, number, make("span", { className: "unit" }, unit)),
      range,
      mistake,
    );
    const showAbout = (): void => write(at("about"), about);
    row.addEventListener("pointerenter", showAbout);
    row.addEventListener("focusin", showAbout);
    this.rows.set(entry, { range, number });
    return row;
  }

  private refresh(except?: HTMLInputElement): void {
    for (const [entry, { range, number }] of this.rows) {
      const value = entry.read(this.values);
      range.value = String(value);
      range.setAttribute("aria-valuetext", `${number.value} ${entry.unit}`);
      // Do not overwrite an entry in progress with the server's report of an earlier change.
      if (number !== this.typing && (number !== except || document.activeElement !== number)) number.value = short(value);
    }
  }

  /** Send the values, at most every SEND_INTERVAL_MS; the last change is always sent. */
  private push(): void {
    this.last = performance.now();
    const wait = this.sent + SEND_INTERVAL_MS - performance.now();
    clearTimeout(this.timer);
    if (wait > 0) {
      this.timer = window.setTimeout(() => this.push(), wait);
      return;
    }
    this.sent = performance.now();
    this.send(this.name, this.values);
  }
}

/** Entries of a parameter; a direction is entered as two angles. */
function entries(parameter: Parameter): Entry[] {
  const { name, low, high, about } = parameter;
  if (typeof parameter.default === "number") {
    const [unit, factor] = displayUnit(parameter);
    const step = ((high - low) * factor) / 400;
    return [
      {
        id: `entry-${name}`,
        label: title(name),
        unit,
        low: low * factor,
        high: high * factor,
        step: (high - low) * factor > 20 ? 0.5 : 10 ** Math.floor(Math.log10(step)),
        about,
        read: (values) => (values[name] as number) * factor,
        put: (values, value) => (values[name] = value / factor),
      },
    ];
  }
  const angles = (values: Values): { tilt: number; azimuth: number } => spherical(values[name] as Vector);
  // Keep the azimuth while the direction is vertical, so that tilting it again goes the same way.
  let azimuth: number | null = null;
  return [
    {
      id: `entry-${name}-tilt`,
      label: `${title(name)} tilt`,
      unit: "°",
      low: 0,
      high: 90,
      step: 0.5,
      about: `${about}: angle from the vertical`,
      read: (values) => angles(values).tilt,
      put: (values, value) => (values[name] = direction(value, azimuth ?? angles(values).azimuth)),
    },
    {
      id: `entry-${name}-azimuth`,
      label: `${title(name)} azimuth`,
      unit: "°",
      low: -180,
      high: 180,
      step: 1,
      about: `${about}: angle about the vertical, from +x`,
      read: (values) => (angles(values).tilt < 0.01 ? (azimuth ?? 0) : angles(values).azimuth),
      put: (values, value) => {
        azimuth = value;
        values[name] = direction(angles(values).tilt, value);
      },
    },
  ];
}

/** Six significant digits distinguish all settings of a slider. */
const short = (value: number): string => String(Number(value.toPrecision(6)));
/** Label of a parameter: `half_width_deg` becomes "half width". */
const title = (name: string): string => name.replace(/_deg$/, "").replaceAll("_", " ");
/** Convenient display unit of a parameter, and the factor to it. */
function displayUnit({ unit, high }: Parameter): [string, number] {
  if (unit === "m" && high <= 0.2) return ["mm", 1e3];
  if (unit === "Pa" && high >= 1e9) return ["GPa", 1e-9];
  return [unitOf(unit), 1];
}

const unitOf = (unit: string): string => (unit === "deg" ? "°" : unit === "1" ? "" : unit);
