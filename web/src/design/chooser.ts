// The page of `haptorb design show`: a design is chosen, its device starts with its coils off, and the console's own
// page, in a frame, shows it and lets it be felt.

import { at, make, write } from "../panels/dom";
import { cover, UNKNOWN } from "../panels/lock";
import { UnknownToken, token } from "../session";
import { describe, type Designs } from "./designs";
import { Numbers } from "./numbers";
import { Scatter } from "./scatter";

const OFTEN = 400; // ms between two questions while a device starts
const SELDOM = 2000; // ms otherwise: another page may choose, the program may end
const NAMED = 2; // objectives beside the name of the device that runs; the table has all of them
const LOST = 3; // questions without an answer after which the page is covered; it goes on asking

/** What the program does now. */
interface Now {
  state: "none" | "starting" | "running" | "refused";
  /** of the design, −1 for none; the base device has none either, and `base` is true */
  row: number;
  base: boolean;
  url: string;
  text: string;
}

declare global {
  interface Window {
    /** for tests */
    chooser: { marked: number; now: Now | null };
  }
}

const UNREACHED = {
  title: "The program does not respond",
  text: "This page comes back by itself when it does. If the program has ended, start `haptorb design show RESULTS`, and open the address that it prints.",
};
const BASE = -1; // what is asked for to have the base device

async function ask<T>(path: string, body?: unknown): Promise<T> {
  const headers = { authorization: `Bearer ${token()}`, "content-type": "application/json" };
  const answer = await fetch(path, body === undefined ? { headers } : { method: "POST", headers, body: JSON.stringify(body) });
  if (answer.status === 403) throw new UnknownToken(await answer.text());
  if (!answer.ok) throw new Error((await answer.text()).trim());
  return (await answer.json()) as T;
}

class Chooser {
  private readonly numbers: Numbers;
  private readonly scatter: Scatter;
  private readonly picks = at<HTMLSelectElement>("picks");
  private readonly feel = at<HTMLButtonElement>("feel");
  private readonly stop = at<HTMLButtonElement>("stop");
  private frame: HTMLIFrameElement | null = null;
  private marked = BASE;
  private own = false; // whether this page asked for what starts
  private misses = 0;
  private timer = 0;

  constructor(private readonly designs: Designs) {
    window.chooser = { marked: BASE, now: null };
    document.title = `haptorb · ${designs.title}`;
    write(at("title"), designs.title);
    this.numbers = new Numbers(designs);
    this.scatter = new Scatter(designs, (row) => this.mark(row), (row) => void this.choose(row));
    at("scatter").append(this.scatter.root);
    at("numbers").append(this.numbers.root);
    this.picks.append(make("option", { value: String(BASE) }, `${designs.base} (base device)`));
    this.picks.append(...designs.picks.map(({ row, reason }, k) => make("option", { value: String(row) }, `${k + 1}: ${designs.names[row]}, ${reason}`)));
    this.picks.append(make("option", { value: "other", hidden: true }, "another design"));
    this.picks.addEventListener("change", () => {
      if (Number(this.picks.value) >= 0) this.mark(Number(this.picks.value));
      else this.marked = BASE;
      this.button();
    });
    this.feel.addEventListener("click", () => void this.choose(this.marked));
    this.stop.addEventListener("click", () => void this.halt());
    addEventListener("keydown", (event) => event.key === "Escape" && void this.halt());
    if (designs.picks.length) this.mark(designs.picks[0]!.row);
    void this.look();
  }

  private mark(row: number): void {
    this.marked = window.chooser.marked = row;
    this.numbers.show(row);
    this.scatter.show(row);
    this.picks.value = this.designs.picks.some((one) => one.row === row) ? String(row) : "other";
    this.button();
  }

  private button(): void {
    this.feel.disabled = window.chooser.now?.state === "starting";
    const name = this.marked < 0 ? this.designs.base : this.designs.names[this.marked]!;
    write(this.feel, `Feel ${name}`);
  }

  private async choose(row: number): Promise<void> {
    if (window.chooser.now?.state === "starting") return;
    try {
      this.own = true;
      this.show(await ask<Now>("api/choose", { row }));
    } catch (mistake) {
      this.say(`Not started: ${(mistake as Error).message}`, true);
    }
    this.later(OFTEN);
  }

  /** Coils off at once; they stay off until somebody engages them in the console. */
  private async halt(): Promise<void> {
    try {
      await ask("api/stop", {});
    } catch (mistake) {
      this.say(`STOP was not confirmed: ${(mistake as Error).message}. Press Ctrl-C in the terminal.`, true);
    }
  }

  private later(time: number): void {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.look(), time);
  }

  private async look(): Promise<void> {
    try {
      this.show(await ask<Now>("api/now"));
      this.misses = 0;
      cover(null);
    } catch {
      if (++this.misses >= LOST) cover(UNREACHED);
    }
    this.later(window.chooser.now?.state === "starting" ? OFTEN : SELDOM);
  }

  private say(text: string, bad: boolean): void {
    const state = at("state");
    write(state, text);
    state.dataset["tone"] = bad ? "bad" : "";
  }

  private show(now: Now): void {
    window.chooser.now = now;
    const name = now.base ? `${this.designs.base}, the base device` : now.row >= 0 ? describe(this.designs, now.row, NAMED) : "";
    const said = {
      none: "No device runs. Choose a design.",
      starting: `Starting ${name}. ${now.text}`,
      running: `SIMULATED: ${name}`,
      refused: now.text,
    }[now.state];
    this.say(said, now.state === "refused");
    this.stop.disabled = now.state !== "running";
    this.scatter.take(now.row);
    this.button();
    if (now.state !== "running") {
      this.frame?.remove();
      this.frame = null;
    } else if (this.frame?.src !== now.url) {
      this.frame?.remove();
      this.frame = make("iframe", { src: now.url, title: `Console: ${name}` });
      at("device").append(this.frame);
      // On a narrow screen the device is below everything else.
      if (this.own) at("device").scrollIntoView({ block: "end" });
      this.own = false;
    }
    at("none").hidden = now.state === "running";
  }
}

addEventListener("hashchange", () => location.reload());

if (!token()) cover(UNKNOWN);
else
  ask<Designs>("api/designs").then(
    (designs) => new Chooser(designs),
    (mistake: unknown) => cover(mistake instanceof UnknownToken ? UNKNOWN : UNREACHED),
  );
