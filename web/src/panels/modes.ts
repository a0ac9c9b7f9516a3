// Linkage panel of a motor: mode, clutch, and pose and wrench of the object.

import { norm, type Sample } from "../sample";
import { angles } from "../scene/rotor_angles";
import { at, formatNumber, write } from "./dom";

const WORDS = ["", "translate", "rotate"] as const;
const DEG_PER_RAD = 180 / Math.PI;

export class ModePanel {
  private mode = 0;
  private engaged = true;
  private control = false;

  constructor(
    private readonly send: (command: Record<string, unknown>) => void,
  ) {
    at("target").hidden = false;
    document.body.classList.add("moded");
    at("mode-translate").addEventListener("click", () => this.choose("translate"));
    at("mode-rotate").addEventListener("click", () => this.choose("rotate"));
    at("mode-clutch").addEventListener("click", () => this.clutch(!this.engaged));
    addEventListener("keydown", (event) => this.key(event));
    addEventListener("keyup", (event) => this.up(event));
    // When the page loses the focus, no keyup event comes: clutch in, as if the key were released.
    addEventListener("blur", () => this.release());
  }

  private held = false;

  enable(yes: boolean): void {
    this.control = yes;
    for (const id of ["mode-translate", "mode-rotate", "mode-clutch"]) at<HTMLButtonElement>(id).disabled = !yes;
  }

  show(sample: Sample): void {
    this.mode = sample.number("mode");
    this.engaged = sample.number("engaged") !== 0;
    const known = Number.isFinite(this.mode);
    at("mode-translate").setAttribute("aria-pressed", String(this.mode === 1));
    at("mode-rotate").setAttribute("aria-pressed", String(this.mode === 2));
    at("mode-clutch").setAttribute("aria-pressed", String(known && !this.engaged));
    const [move, turn] = [...sample.list("clutch_share")] as [number, number];
    for (const [id, share] of [["share-translate", move], ["share-rotate", turn]] as const) {
      const value = Number.isFinite(share) ? share : 0;
      at<HTMLMeterElement>(id).value = value;
    }
    write(at("clutch-word"), known ? this.describeMode(move, turn) : "–");
    const p = sample.vector("object");
    for (const i of [0, 1, 2] as const) write(at(`object-${i}`), formatNumber(p[i] * 1000, 2));
    const q = sample.quaternion("object_q");
    const turns = Number.isFinite(q[0]) ? angles(q) : [NaN, NaN, NaN];
    for (const i of [0, 1, 2] as const) write(at(`object-turn-${i}`), formatNumber(turns[i]! * DEG_PER_RAD, 2));
    write(at("object-force"), formatNumber(norm(sample.vector("object_wrench")), 1));
    write(at("object-torque"), formatNumber(norm(sample.vector("object_wrench", 3)), 2));
    const contacts = sample.list("contacts");
    const pushes = [0, 1].map((k) => norm([...contacts.subarray(8 * k + 5, 8 * k + 8)]));
    write(at("contact-forces"), pushes.map((force) => formatNumber(force, 1)).join(" · "));
  }

  /** Summary for screen readers. */
  sentence(sample: Sample): string {
    const mode = WORDS[sample.number("mode")] ?? "";
    if (!mode) return "";
    const [x, y, z] = sample.vector("object").map((value) => formatNumber(value * 1000, 1));
    const held = document.querySelector("[data-held]")?.textContent ?? "plug";
    const hold = this.engaged ? "" : `, ${held} released`;
    return `mode ${mode}${hold}; ${held} ${x} millimetres out, ${y} sideways, ${z} up, resisted by ${formatNumber(norm(sample.vector("object_wrench")), 1)} newton`;
  }

  private describeMode(move: number, turn: number): string {
    if (!this.engaged) return Math.max(move, turn) > 0.01 ? "releasing" : "released";
    return Math.max(move, turn) > 0.99 ? "clutched" : "clutching";
  }

  private choose(mode: "translate" | "rotate"): void {
    if (!this.control) return;
    this.send({ do: "mode", mode });
    write(at("polite"), `Mode ${mode}.`);
  }

  private clutch(engaged: boolean): void {
    if (!this.control) return;
    this.send({ do: "clutch", engaged });
    write(at("polite"), engaged ? "Clutched." : "Released.");
  }

  private key(event: KeyboardEvent): void {
    const target = event.target as HTMLElement;
    if (event.repeat || event.ctrlKey || event.metaKey || event.altKey) return;
    if (target.closest("input, select, dialog[open]")) return;
    switch (event.key.toLowerCase()) {
      case "r":
        return this.choose("rotate");
      case "t":
        return this.choose("translate");
      case "c":
        this.held = this.control;
        this.clutch(false);
    }
  }

  private up(event: KeyboardEvent): void {
    if (event.key.toLowerCase() === "c") this.release();
  }

  private release(): void {
    if (!this.held) return;
    this.held = false;
    this.clutch(true);
  }
}
