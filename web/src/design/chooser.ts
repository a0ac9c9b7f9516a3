// Page of `haptorb design show`: the user chooses a design; its device starts with the coils off, and its console appears
// in an iframe.

import { at, make, write } from "../panels/dom";
import { coverPage, MISSING_TOKEN } from "../panels/lock";
import { UnknownToken, token } from "../session";
import { describe, type Designs } from "./designs";
import { Numbers } from "./numbers";
import { Scatter } from "./scatter";

const STARTING_POLL_INTERVAL_MS = 400; // while a device starts
const POLL_INTERVAL_MS = 2000; // otherwise: another page may choose a design, the program may end
const TITLE_OBJECTIVES = 2; // named beside the running design; the table shows all
const MAX_MISSED_RESPONSES = 3; // before the page is covered; polling continues

/** State of the program. */
interface ProgramState {
  state: "none" | "starting" | "running" | "refused";
  /** row of the running design; −1: none, or the base device if `base` */
  row: number;
  base: boolean;
  url: string;
  text: string;
}

declare global {
  interface Window {
    /** for tests */
    chooser: { marked: number; now: ProgramState | null };
  }
}

const NO_RESPONSE = {
  title: "The program does not respond",
  text: "This page reconnects by itself. If the program has ended, start `haptorb design show RESULTS`, and open the address that it prints.",
};
const BASE_ROW = -1; // requests the base device

async function request<T>(path: string, body?: unknown): Promise<T> {
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
  private marked = BASE_ROW;
  private own = false; // whether this page requested the start
  private missedResponses = 0;
  private timer = 0;

  constructor(private readonly designs: Designs) {
    window.chooser = { marked: BASE_ROW, now: null };
    document.title = `haptorb · ${designs.title}`;
    write(at("title"), designs.title);
    this.numbers = new Numbers(designs);
    this.scatter = new Scatter(designs, (row) => this.mark(row), (row) => void this.choose(row));
    at("scatter").append(this.scatter.root);
    at("numbers").append(this.numbers.root);
    this.picks.append(make("option", { value: String(BASE_ROW) }, `${designs.base} (base device)`));
    this.picks.append(...designs.picks.map(({ row, reason }, k) => make("option", { value: String(row) }, `${k + 1}: ${designs.names[row]}, ${reason}`)));
    this.picks.append(make("option", { value: "other", hidden: true }, "another design"));
    this.picks.addEventListener("change", () => {
      if (Number(this.picks.value) >= 0) this.mark(Number(this.picks.value));
      else this.marked = BASE_ROW;
      this.button();
    });
    this.feel.addEventListener("click", () => void this.choose(this.marked));
    this.stop.addEventListener("click", () => void this.sendStop());
    addEventListener("keydown", (event) => event.key === "Escape" && void this.sendStop());
    if (designs.picks.length) this.mark(designs.picks[0]!.row);
    void this.poll();
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
      this.show(await request<ProgramState>("api/choose", { row }));
    } catch (mistake) {
      this.say(`Not started: ${(mistake as Error).message}`, true);
    }
    this.schedulePoll(STARTING_POLL_INTERVAL_MS);
  }

  /** Switch the coils off at once, until a person engages them in the console. */
  private async sendStop(): Promise<void> {
    try {
      await request("api/stop", {});
    } catch (mistake) {
      this.say(`STOP was not confirmed: ${(mistake as Error).message}. Press Ctrl-C in the terminal.`, true);
    }
  }

  private schedulePoll(time: number): void {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.poll(), time);
  }

  private async poll(): Promise<void> {
    try {
      this.show(await request<ProgramState>("api/now"));
      this.missedResponses = 0;
      coverPage(null);
    } catch {
      if (++this.missedResponses >= MAX_MISSED_RESPONSES) coverPage(NO_RESPONSE);
    }
    this.schedulePoll(window.chooser.now?.state === "starting" ? STARTING_POLL_INTERVAL_MS : POLL_INTERVAL_MS);
  }

  private say(text: string, bad: boolean): void {
    const state = at("state");
    write(state, text);
    state.dataset["tone"] = bad ? "bad" : "";
  }

  private show(now: ProgramState): void {
    window.chooser.now = now;
    const name = now.base ? `${this.designs.base}, the base device` : now.row >= 0 ? describe(this.designs, now.row, TITLE_OBJECTIVES) : "";
    const said = {
      none: "No device runs. Choose a design.",
      starting: `Starting ${name}. ${now.text}`,
      running: `SIMULATED: ${name}`,
      refused: now.text,
    }[now.state];
    this.say(said, now.state === "refused");
    this.stop.disabled = now.state !== "running";
    this.scatter.setChosen(now.row);
    this.button();
    if (now.state !== "running") {
      this.frame?.remove();
      this.frame = null;
    } else if (this.frame?.src !== now.url) {
      this.frame?.remove();
      this.frame = make("iframe", { src: now.url, title: `Console: ${name}` });
      at("device").append(this.frame);
      // On a narrow screen the device is at the bottom of the page.
      if (this.own) at("device").scrollIntoView({ block: "end" });
      this.own = false;
    }
    at("none").hidden = now.state === "running";
  }
}

addEventListener("hashchange", () => location.reload());

if (!token()) coverPage(MISSING_TOKEN);
else
  request<Designs>("api/designs").then(
    (designs) => new Chooser(designs),
    (mistake: unknown) => coverPage(mistake instanceof UnknownToken ? MISSING_TOKEN : NO_RESPONSE),
  );
