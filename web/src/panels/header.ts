// Header: status, loop timing, connected programs, and re-engaging.

import type { Session } from "../session";
import type { Status } from "../status";
import { at, make, formatNumber, write } from "./dom";

const CONFIRM_TIMEOUT_MS = 6000; // between "Re-engage…" and "Coils on now"

export interface Health {
  rate_hz: number | null;
  success: number | null;
  lateness_p99_us: number | null;
  pose_age_ms: number | null; // 99th percentile of the age of valid poses
  recording_trouble: string; // empty: none, as the next two
  warning: string;
  world_trouble: string; // contained in `warning`
  missing_pose: string; // text about the missing pose; empty while poses are valid
  connections: Connection[]; // of each server, with the programs connected to it
}

export interface Connection {
  server: string;
  address: string;
  count: number;
  clients: { name: string; session: number; rate_hz: number; holds: boolean }[];
  /** programs that commanded last, in order of time; end_s null: still commanding */
  programs?: { name: string; start_s: number; end_s: number | null; end: string }[];
}

export class Header {
  private armed = 0;
  private offered = "";

  constructor(
    session: Session,
    private readonly engage: () => void,
  ) {
    write(at("device"), session.device.name);
    document.title = `haptorb · ${session.device.name}`;
    at("simulated").hidden = !session.simulated;
  }

  status(now: Status, control: boolean): void {
    const state = at("state");
    state.dataset["tone"] = now.tone;
    write(state.querySelector("strong")!, now.word);
    at("unknown").hidden = now.word !== "coil state unknown";
    at("stop").dataset["off"] = String(["stopped", "tripped", "off", "no pose yet", "tracker lost"].includes(now.word));
    const alert = at("alert");
    const hidden = now.reason === "" || now.word === "waiting";
    if (alert.hidden !== hidden) alert.hidden = hidden;
    alert.dataset["tone"] = now.tone;
    write(at("alert-word"), hidden ? "" : `${now.word[0]!.toUpperCase()}${now.word.slice(1)}.`);
    write(at("alert-text"), hidden ? "" : now.reason);
    this.offer(now.engageable && control);
  }

  loop(health: Health | null): void {
    if (!health || health.rate_hz === null || health.success === null || health.lateness_p99_us === null) {
      write(at("loop"), "");
      return;
    }
    const onTime = Math.floor(1e4 * health.success + 1e-6) / 100; // rounded down: 100 % is every tick
    const parts = [`loop ${formatNumber(onTime, 2)} % on time`];
    at("loop").title = `${formatNumber(health.rate_hz, 0)} Hz; 99 % of the ticks began at most ${formatNumber(health.lateness_p99_us, 0)} µs late`;
    // Without a tracker there is no pose age.
    if (health.pose_age_ms) parts.push(`pose ${formatNumber(health.pose_age_ms, 0)} ms`);
    if (health.recording_trouble) parts.push("not recording");
    write(at("loop"), parts.map((part) => part.replaceAll(" ", "\u00a0")).join(" · ")); // no line break between number and unit
  }

  /** Show connected programs and their rates. */
  showConnections(connections: Connection[]): void {
    const box = at("connected");
    box.hidden = connections.length === 0;
    if (box.hidden) return;
    // The rate comes first, because a long name is truncated on a narrow screen.
    const one = (client: Connection["clients"][number]): string => `${formatNumber(client.rate_hz, 0)} Hz ${client.name}`;
    const servers = connections.map((server) => {
      const [first] = [...server.clients].sort((a, b) => Number(b.holds) - Number(a.holds) || b.rate_hz - a.rate_hz);
      const last = server.programs?.at(-1);
      if (!first) return `${server.server}: nobody${last && last.end_s !== null ? ` (${last.name}: ${last.end})` : ""}`;
      return `${server.server}: ${one(first)}${server.count > 1 ? ` +${server.count - 1}` : ""}`;
    });
    write(box, servers.join(" · "));
    const lines = connections.flatMap((server) => [
      `${server.server} ${server.address}`,
      ...server.clients.map((client) => `${one(client)}, ${client.holds ? "commands" : "watches"}`),
      ...(server.programs ?? []).map(({ name, start_s, end_s, end }) =>
        `${name}: commanded from ${formatNumber(start_s, 1)} s ${end_s === null ? "on" : `to ${formatNumber(end_s, 1)} s (${end})`}`,
      ),
    ]);
    box.title = `${lines.join("\n")}\nKeys 1, 2, 3 are the buttons a, b, c.`;
  }

  /** Offer re-engaging in two deliberate steps; the first expires after CONFIRM_TIMEOUT_MS. */
  private offer(possible: boolean): void {
    if (performance.now() > this.armed + CONFIRM_TIMEOUT_MS) this.armed = 0;
    const now = !possible ? "" : this.armed ? "sure" : "first";
    if (now === this.offered) return;
    this.offered = now;
    const box = at("engage");
    const focused = box.contains(document.activeElement);
    if (now === "") {
      this.armed = 0;
      box.replaceChildren();
    } else if (now === "first") {
      const first = make("button", { type: "button" }, "Re-engage…");
      first.addEventListener("click", () => {
        this.armed = performance.now();
        this.offer(true);
      });
      box.replaceChildren(first);
    } else {
      const sure = make("button", { type: "button", className: "sure" }, "Coils on now");
      const no = make("button", { type: "button" }, "Cancel");
      sure.addEventListener("click", () => {
        this.armed = 0;
        this.engage();
      });
      no.addEventListener("click", () => this.disarm());
      box.replaceChildren(sure, no);
    }
    if (focused || now === "sure") box.querySelector("button")?.focus();
  }

  disarm(): void {
    this.armed = 0;
    this.offer(this.offered !== "");
  }
}
