// The world's parameters as sliders with typed entry; a change acts at once.

import { readNumber } from "../entry";
import { direction, spherical, type Vector } from "../sample";
import type { Parameter, Session, Values, World } from "../session";
import { at, make, write, writeRemarks } from "./dom";

const EVERY = 33; // ms between two changes sent while a slider is dragged

const SETTLED = 1000; // ms after the last change made here within which the server may still tell of the one before

/** One number on the panel; a direction has two. */
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
  private awaited = 0;
  private typing: HTMLInputElement | undefined; // the field with digits that are not in effect yet

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

  /** What should be said of the world as it is set: strain and stress of its hooks. */
  remark(remarks: string[]): void {
    writeRemarks(at("remarks"), remarks);
  }

  /** These worlds can be chosen; a user's own may have other parameters than before. */
  offer(worlds: World[]): void {
    this.session.worlds = worlds;
    this.picker.replaceChildren(...worlds.map(({ name, about }) => make("option", { value: name, title: about }, name)));
    this.name = ""; // whatever comes next is shown at once, with new sliders
    this.last = 0;
  }

  /** The world is this now, whoever changed it. */
  show(name: string, values: Values): void {
    const another = name !== this.name;
    // While somebody changes values, their own hand is ahead of what the server says: that is shown when the hand rests.
    clearTimeout(this.later);
    const wait = this.last + SETTLED - performance.now();
    if (!another && wait > 0) {
      this.later = window.setTimeout(() => this.show(name, values), wait);
      return;
    }
    this.name = name;
    this.values = structuredClone(values);
    if (!this.session.worlds.some((world) => world.name === name)) this.picker.append(make("option", { value: name }, name));
    this.picker.value = name;
    write(at("world-title"), `World: ${name}`);
    if (another) this.build();
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
    // Of type text: a field of type number drops letters while they are typed, so that 1a9 would become 19.
    const number = make("input", { type: "text", inputMode: "decimal", autocomplete: "off", className: "number", id });
    number.setAttribute("aria-describedby", `${id}-mistake`);
    const mistake = make("p", { className: "refused", id: `${id}-mistake`, hidden: true });
    mistake.setAttribute("role", "alert");
    const complain = (text: string): void => {
      write(mistake, text);
      mistake.hidden = text === "";
      number.setAttribute("aria-invalid", String(text !== ""));
    };
    range.setAttribute("aria-label", label);
    range.setAttribute("aria-description", about);
    const changed = (value: number): void => {
      complain("");
      entry.put(this.values, value);
      this.refresh(number);
      this.push();
    };
    range.addEventListener("input", () => changed(range.valueAsNumber));
    number.addEventListener("input", () => {
      this.typing = number;
      complain("");
    });
    number.addEventListener("change", () => {
      const typed = number.value;
      const value = readNumber(typed);
      this.typing = undefined;
      if (value !== null && value >= low && value <= high) changed(value);
      else complain(`“${typed}” is not used: a number from ${short(low)} to ${short(high)}${unit && ` ${unit}`}. ${label} stays ${short(entry.read(this.values))}.`);
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
    const tell = (): void => write(at("about"), about);
    row.addEventListener("pointerenter", tell);
    row.addEventListener("focusin", tell);
    this.rows.set(entry, { range, number });
    return row;
  }

  private refresh(except?: HTMLInputElement): void {
    for (const [entry, { range, number }] of this.rows) {
      const value = entry.read(this.values);
      range.value = String(value);
      range.setAttribute("aria-valuetext", `${number.value} ${entry.unit}`);
      // What somebody is typing stays: the server's word of an earlier change may come in the middle of it.
      if (number !== this.typing && (number !== except || document.activeElement !== number)) number.value = short(value);
    }
  }

  /** At most every 33 ms, and always the last one. */
  private push(): void {
    this.last = performance.now();
    const wait = this.awaited + EVERY - performance.now();
    clearTimeout(this.timer);
    if (wait > 0) {
      this.timer = window.setTimeout(() => this.push(), wait);
      return;
    }
    this.awaited = performance.now();
    this.send(this.name, this.values);
  }
}

/** The entries of one parameter: a direction is set by two angles. */
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
  // The azimuth of a vertical direction is kept, so that tilting it goes the way it was set before.
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

/** With as many digits as tell one setting from another. */
const short = (value: number): string => String(Number(value.toPrecision(6)));
/** `half_width_deg` is a half width. */
const title = (name: string): string => name.replace(/_deg$/, "").replaceAll("_", " ");
/** The unit in which a parameter is read easily, and how many of them are one of its own. */
function displayUnit({ unit, high }: Parameter): [string, number] {
  if (unit === "m" && high <= 0.2) return ["mm", 1e3];
  if (unit === "Pa" && high >= 1e9) return ["GPa", 1e-9];
  return [unitOf(unit), 1];
}

const unitOf = (unit: string): string => (unit === "deg" ? "°" : unit === "1" ? "" : unit);
