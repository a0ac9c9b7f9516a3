// Status of the run as a word with a colour, the reason and what to do; never as a colour alone.

import type { Sample } from "./sample";
import type { Session } from "./session";

export type Tone = "good" | "warn" | "bad" | "off";

export interface Status {
  word: string;
  tone: Tone;
  /** cause, and what to do; may be empty */
  reason: string;
  /** whether re-engaging is possible */
  engageable: boolean;
}

/** State of server, servo and device that is not in the sample. */
export interface LinkState {
  disconnected: boolean;
  /** while disconnected: no server responds at all; otherwise it is only slow */
  serverEnded: boolean;
  servoEnded: boolean;
  stale: boolean;
  /** coil state in the last row received; still valid for a device that has lost its servo */
  coils: number;
  /** the server's text about the missing pose; empty while poses are valid */
  missingPose: string;
  /** program that commanded at the last trip; empty: none */
  tripProgram: string;
}

const GUARD = { off: 0, ramping: 1, running: 2, derated: 3, tripped: 4 };
const COILS = { off: 0, unknown: 2 };
const ZERO_CELSIUS_K = 273.15;

export function status(sample: Sample, session: Session, link: LinkState): Status {
  if (link.coils === COILS.unknown) {
    const reason = "The device has not confirmed that its coils are off: keep away from it, and switch off its supply.";
    return { word: "coil state unknown", tone: "bad", reason, engageable: false };
  }
  if (link.disconnected && !link.serverEnded) {
    const reason = "The console's server does not respond yet, because the computer is busy: nothing here is live until it does. This page retries by itself.";
    return { word: "slow, retrying", tone: "bad", reason, engageable: false };
  }
  if (link.disconnected) {
    const reason = "The console's server does not respond: nothing here is live. Start `haptorb run` again, and open the address that it prints.";
    return { word: "disconnected", tone: "bad", reason, engageable: false };
  }
  if (link.servoEnded) {
    const off = session.simulated || link.coils === COILS.off;
    const reason = off
      ? "The real-time process has ended; the coils are off. Start `haptorb run` again."
      : "The real-time process has ended, and the device did not confirm that the coils are off. Check before you touch it.";
    return { word: "servo ended", tone: "bad", reason, engageable: false };
  }
  if (link.stale || Number.isNaN(sample.number("guard"))) {
    return { word: "waiting", tone: "off", reason: "No sample has arrived for half a second.", engageable: false };
  }
  const hottest = Math.max(...sample.list("winding")) - ZERO_CELSIUS_K;
  switch (sample.number("guard")) {
    case GUARD.tripped: {
      const { word, text } = session.trips[String(sample.number("trip"))] ?? { word: "tripped", text: "Unknown reason." };
      const waits = link.missingPose ? ` ${sentence(link.missingPose)}` : "";
      const by = link.tripProgram ? ` Program: ${link.tripProgram}.` : "";
      return { word, tone: "bad", reason: text + waits + by, engageable: true };
    }
    case GUARD.off:
      if (link.missingPose) return { word: "no pose yet", tone: "off", reason: sentence(link.missingPose), engageable: false };
      return { word: "off", tone: "off", reason: "The coils are off.", engageable: true };
    case GUARD.derated: {
      const share = (session.limits.stop - hottest) / (session.limits.stop - session.limits.derate);
      const reason = `A winding is at ${hottest.toFixed(0)} °C: currents are reduced to ${(100 * share).toFixed(0)} %.`;
      return { word: "derated", tone: "warn", reason, engageable: false };
    }
  }
  if (sample.number("valid") !== 1) {
    return {
      word: "tracker lost",
      tone: "bad",
      reason: "The pose of the tool is unknown. Bring it back into view.",
      engageable: false,
    };
  }
  if (hottest >= session.limits.warn) {
    const left = duration(sample.number("remaining"));
    return {
      word: "warm",
      tone: "warn",
      reason: `A winding is at ${hottest.toFixed(0)} °C; derating from ${session.limits.derate.toFixed(0)} °C${left ? `, in ${left} at this load` : ""}.`,
      engageable: false,
    };
  }
  if (sample.number("guard") === GUARD.ramping) {
    return { word: "ramping up", tone: "good", reason: "", engageable: false };
  }
  return { word: "running", tone: "good", reason: "", engageable: false };
}

const sentence = (text: string): string => `${text[0]!.toUpperCase()}${text.slice(1)}.`;

/** Format a time as min or s; empty if it is longer than an hour or infinite. */
export function duration(seconds: number): string {
  if (!Number.isFinite(seconds) || seconds > 3600) return "";
  if (seconds >= 90) return `${Math.round(seconds / 60)} min`;
  return `${Math.max(0, Math.round(seconds))} s`;
}
