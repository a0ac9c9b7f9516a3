// Panel of a feel session: choose designs, compare A and B, rate. The server keeps the state.

import type { FeelState } from "../session";
import { at, make, write, writeRemarks } from "./dom";

const SLOTS = ["a", "b"] as const;
type Act = Record<string, unknown> & { act: string };

export class FeelPanel {
  private now: FeelState;
  private control = false;

  constructor(
    first: FeelState,
    private readonly send: (act: Act) => void,
  ) {
    this.now = first;
    document.body.classList.add("feeling");
    at("feel").hidden = false;
    const [low, high] = first.scale;
    for (let score = low; score <= high; score++) {
      const button = make("button", { type: "button", value: String(score) }, String(score));
      button.setAttribute("aria-keyshortcuts", String(score));
      button.addEventListener("click", () => this.rate(score));
      at("feel-scores").append(button);
    }
    for (const slot of SLOTS) {
      at(`feel-${slot}`).addEventListener("click", () => this.act({ act: "slot", slot }));
      const picker = at<HTMLSelectElement>(`feel-pick-${slot}`);
      picker.addEventListener("change", () => {
        this.act({ act: "pair", slot, number: Number(picker.value) });
        picker.blur(); // so that number keys rate again
      });
    }
    const scale = at<HTMLInputElement>("feel-scale");
    scale.addEventListener("input", () => write(at("feel-scale-now"), scale.valueAsNumber.toFixed(2)));
    scale.addEventListener("change", () => this.act({ act: "scale", scale: scale.valueAsNumber }));
    at("feel-next").addEventListener("click", () => this.act({ act: "next" }));
    at("feel-finish").addEventListener("click", () => this.act({ act: "finish" }));
    at("feel-hide").addEventListener("change", () => this.act({ act: "hide", hide: at<HTMLInputElement>("feel-hide").checked }));
    at<HTMLFormElement>("feel-who").addEventListener("submit", (event) => {
      event.preventDefault();
      this.act({ act: "person", person: at<HTMLInputElement>("feel-person").value });
      (document.activeElement as HTMLElement | null)?.blur(); // so that number keys rate again
    });
    addEventListener("keydown", (event) => this.key(event));
    this.show(first);
  }

  enable(yes: boolean): void {
    this.control = yes;
    const off = !yes || this.now.finished;
    for (const one of at("feel").querySelectorAll<HTMLButtonElement | HTMLInputElement | HTMLSelectElement>("button, input, select")) one.disabled = off;
  }

  show(now: FeelState): void {
    const before = this.now;
    this.now = now;
    document.body.classList.toggle("blind", now.hidden);
    write(at("feel-title"), now.title);
    write(at("feel-now"), now.label);
    write(at("feel-felt"), now.felt ? "" : "Not felt yet: move the handle, then rate.");
    writeRemarks(at("feel-remarks"), now.designs[now.number - 1]?.remarks ?? []);
    for (const button of at("feel-scores").querySelectorAll("button")) {
      button.setAttribute("aria-pressed", String(Number(button.value) === now.score));
    }
    for (const slot of SLOTS) {
      const picker = at<HTMLSelectElement>(`feel-pick-${slot}`);
      picker.replaceChildren(...now.designs.map(({ number, label }) => make("option", { value: String(number) }, label)));
      picker.value = String(now[slot]);
      at(`feel-${slot}`).setAttribute("aria-pressed", String(now[slot] === now.number));
    }
    at("feel-designs").replaceChildren(
      ...now.designs.map(({ number, label, score }) => {
        const row = make("button", { type: "button" }, label);
        row.disabled = !this.control || now.finished;
        row.addEventListener("click", () => this.act({ act: "feel", number }));
        if (number === now.number) row.setAttribute("aria-current", "true");
        return make("li", {}, row, make("span", {}, score === null ? "not rated" : `rated ${score}`));
      }),
    );
    const rated = now.designs.filter(({ score }) => score !== null).length;
    write(at("feel-count"), `${rated} of ${now.designs.length} rated by ${now.person || "a person without a code"}`);
    at<HTMLInputElement>("feel-hide").checked = now.hidden;
    const { now: scale, low, high, reason, hand } = now.torque_scale;
    const range = at<HTMLInputElement>("feel-scale");
    Object.assign(range, { min: String(low), max: String(Math.max(low, Math.floor(high * 20) / 20)) });
    range.value = String(scale);
    write(at("feel-scale-now"), scale.toFixed(2));
    write(at("feel-scale-why"), `1 N at the part is ${hand.toPrecision(2)} N in the hand. At most ${range.max}: ${reason}`);
    const who = at<HTMLInputElement>("feel-person");
    if (document.activeElement !== who) who.value = now.person;
    at("feel-people").replaceChildren(...now.people.filter(Boolean).map((code) => make("option", { value: code })));
    at("feel-end").hidden = !now.finished;
    this.enable(this.control);
    if (now.finished && !before.finished) write(at("polite"), "The session has ended.");
    else if (now.feeling !== before.feeling) write(at("polite"), `Now ${now.label}.`);
    else if (now.score !== before.score && now.score !== null) write(at("polite"), `${now.label} rated ${now.score}.`);
  }

  private rate(score: number): void {
    this.act({ act: "rate", score, feeling: this.now.feeling });
  }

  private act(act: Act): void {
    if (this.control && !this.now.finished) this.send(act);
  }

  private key(event: KeyboardEvent): void {
    const target = event.target as HTMLElement;
    if (event.repeat || event.ctrlKey || event.metaKey || event.altKey) return;
    if (target.closest("input:not([type=checkbox], [type=range]), select, dialog[open]")) return;
    const key = event.key.toLowerCase();
    if (/^[0-9]$/.test(key) && Number(key) >= this.now.scale[0] && Number(key) <= this.now.scale[1]) this.rate(Number(key));
    else if (key === "a" || key === "b") this.act({ act: "slot", slot: key });
    else if (key === "n") this.act({ act: "next" });
  }
}
