// Experimenter's page: state of the session, prompts and answers, safety events, and controls.

import { POWER_OFF_INSTRUCTION, element, Connection, setText, setVisible, type StudyDescription, type Pen, type View } from "./connection";
import { drawPlan, describeForce } from "./plan";

interface Trip {
  t: number;
  code: string;
  reason: string;
  trial: number;
}

interface Prompt {
  phase: string;
  condition: string;
  other: string;
  set_point: number;
  level: number;
  interval: number;
}

interface Row extends Prompt {
  trial: number;
  answer: number | null;
  seconds: number;
  safety: string[];
  repeats: number;
  /** part of the session's recording that contains this trial */
  recording: string | null;
}

interface ExperimenterView extends View {
  trouble: string;
  pages: number;
  draft: number | null;
  code: string;
  /** participant codes in the study's database */
  taken: { code: string; state: string; answered: number }[];
  /** an unused code; empty: unknown */
  free: string;
  log: Row[];
  seconds?: number;
  trips?: Trip[];
  /** interruptions of the session, oldest first */
  incidents: { kind: string; trial: number; at: string; text: string }[];
  prompt?: Prompt;
}

const STATES: Record<string, [string, string]> = {
  connecting: ["connecting", "off"],
  waiting: ["waiting for a participant", "off"],
  starting: ["device is starting", "warn"],
  consent: ["instructions and consent", "warn"],
  question: ["question", "good"],
  pause: ["between trials", "good"],
  break: ["break", "good"],
  running: ["trial", "good"],
  "time is up": ["time is up, no answer yet", "warn"],
  "device off": ["device off, the trial is waiting", "bad"],
  paused: ["STOPPED, coils off", "bad"],
  done: ["done", "off"],
  left: ["ended; can be continued", "off"],
  aborted: ["aborted", "off"],
  declined: ["no consent, not begun", "off"],
  failed: ["ended by a failure; can be continued", "bad"],
};
const CONFIRM_TIMEOUT_MS = 6000; // of aborting

let about: StudyDescription | null = null;
let view: ExperimenterView | null = null;
let pen: Pen | null = null;
let rows = "";
let viewers: Record<string, string> = {};
/** browser tabs that wait for a viewer, by part of the recording */
const tabs = new Map<string, Window | null>();
const pad = element<HTMLCanvasElement>("pad");
const code = element<HTMLInputElement>("code");

const connection = new Connection<ExperimenterView>(
  "ws/experimenter",
  {
    about(facts) {
      about = facts;
      document.title = `${facts.study}: experimenter`;
      setText("study", facts.study);
      setVisible("simulated", facts.simulated);
      setVisible("pilot", facts.pilot === true);
      setText("facts-below", `answers: ${facts.database ?? ""} · ${facts.forecast ?? ""}`);
      if (!code.value && facts.code) code.value = facts.code;
    },
    view(next) {
      view = next;
      render();
    },
    pen(next) {
      pen = next;
      paint();
    },
    showMistake,
    viewers(urls) {
      viewers = urls;
      for (const [part, tab] of tabs) {
        if (!urls[part]) continue;
        if (tab && !tab.closed) tab.location.href = urls[part];
        tabs.delete(part);
      }
      if (view) log();
    },
    onClose(refused) {
      view = null;
      pen = null;
      setText("state-word", refused || "no connection");
      element("state").dataset["tone"] = "bad";
      setVisible("session-panel", false);
      setVisible("begin-panel", false);
      setVisible("alert", true);
      setText("alert-word", refused ? "Access refused" : "No connection");
      setText("alert-text", refused || `The study's program does not respond, and STOP does not work on this page now. If the device still pushes: ${POWER_OFF_INSTRUCTION.toLowerCase()} This page reconnects by itself.`);
      setVisible("engage", false);
      setVisible("resume", false);
      element<HTMLButtonElement>("stop").disabled = true;
      paint();
    },
  },
  location.hash.slice(1) || "none",
);

function showMistake(text: string): void {
  if (text) {
    for (const tab of tabs.values()) tab?.close();
    tabs.clear();
  }
  setVisible("mistake", text !== "");
  setText("mistake", text);
  element("last").classList.toggle("mistake", text !== "" && element("session-panel").hidden !== false);
  if (element("session-panel").hidden) setText("last", text);
}

function describePrompt(prompt: Prompt): string {
  const parts = [];
  if (prompt.set_point) parts.push(`set-point ${prompt.set_point}`);
  if (prompt.condition && prompt.condition !== "base") parts.push(prompt.other ? `${prompt.condition} or ${prompt.other}` : prompt.condition);
  if (prompt.level) parts.push(`level ${Number(prompt.level.toPrecision(4))}`);
  if (prompt.interval) parts.push(`${prompt.other ? "first named" : "comparison"} in ${prompt.interval}`);
  if (prompt.phase === "practice") parts.push("practice");
  return parts.join(", ");
}

function render(): void {
  if (!view) return;
  const running = view.code !== "";
  const unsure = view.unconfirmed && (view.stopped !== "" || view.off === true);
  const [word, tone] = unsure ? ["coil state unknown", "bad"] : view.stopped && view.state === "starting" ? ["starting, stays off", "bad"] : (STATES[view.state] ?? [view.state, "off"]);
  setText("state-word", word);
  element("state").dataset["tone"] = tone;
  setVisible("begin-panel", !running);
  setVisible("session-panel", running);
  const inTrial = view.state === "running" || view.state === "time is up";
  element<HTMLButtonElement>("stop").disabled = false;
  setVisible("repeat", inTrial);
  setVisible("skip", view.state === "break");
  const total = view.total ?? 0;
  const bar = element<HTMLProgressElement>("progress");
  bar.max = Math.max(total, 1);
  bar.value = view.done ?? 0;
  setText("progress-word", total ? `${view.done ?? 0} of ${about?.procedure === "staircase" ? "at most " : ""}${total} answered` : "");
  facts();
  showAlarm();
  if (!running) {
    const ends: Record<string, string> = { done: "The last session is complete.", left: "The last session can be resumed with its code.", aborted: "The last session was aborted; its answers are kept.", declined: "The participant did not agree to take part: no trial was asked." };
    const last = view.trouble || ends[view.state];
    if (last) setText("last", last);
    codes();
  }
  incidents();
  log();
  paint();
}

/** Show which codes are taken, which can be resumed, and an unused one. */
function codes(): void {
  const { taken, free } = view!;
  const open = taken.filter((one) => one.state === "open");
  const sentences = [
    free ? `Free: ${free}.` : "",
    open.length ? `To be continued: ${open.map((one) => `${one.code} (${one.answered} answered)`).join(", ")}.` : "",
    taken.length > open.length ? `Taken: ${taken.filter((one) => one.state !== "open").map((one) => `${one.code} (${one.state})`).join(", ")}.` : "",
  ];
  const text = sentences.filter(Boolean).join(" ");
  if (element("taken").textContent === text) return;
  setText("taken", text);
  code.placeholder = free || "P01";
  element("open-codes").replaceChildren(
    ...[free, ...open.map((one) => one.code)].filter(Boolean).map((value) => {
      const option = document.createElement("option");
      option.value = value;
      return option;
    }),
  );
}

function facts(): void {
  const v = view!;
  const facts: [string, string][] = [
    ["participant", `${v.code}${v.resumed ? " (resumed)" : ""}`],
    ["participant's page", v.pages ? (v.pages > 1 ? `${v.pages} are open: close all but one` : "open") : "not open"],
  ];
  if (v.prompt) facts.push(["prompt", describePrompt(v.prompt)]);
  if (v.prompt && v.which && v.prompt.interval) facts.push(["rendered now", `interval ${v.which}`]);
  if (v.state === "running" || v.state === "time is up") {
    facts.push(["answer so far", v.draft === null ? "–" : `${v.draft} (not confirmed)`]);
    facts.push(["time in trial", `${v.seconds ?? 0} s`]);
  }
  if (v.left) facts.push(["rest remaining", `${v.left} s`]);
  if (v.question) facts.push(["question", v.question.text]);
  const list = element("facts");
  const key = JSON.stringify(facts);
  if (list.dataset["key"] === key) return;
  list.dataset["key"] = key;
  list.replaceChildren(
    ...facts.map(([name, value]) => {
      const row = document.createElement("div");
      const [dt, dd] = [document.createElement("dt"), document.createElement("dd")];
      dt.textContent = name;
      dd.textContent = value;
      row.append(dt, dd);
      return row;
    }),
  );
}

/** Show what requires action: a stop, a device that is off, a failed session. */
function showAlarm(): void {
  const v = view!;
  const last = v.trips?.[v.trips.length - 1];
  const stopped = v.stopped !== "" && v.code !== "";
  const off = v.off === true && !stopped; // also in a break, because the next trial would wait for the device
  setVisible("alert", stopped || off || v.state === "failed");
  setVisible("engage", off);
  setVisible("resume", stopped && v.state === "paused");
  if (stopped) {
    const coils = v.unconfirmed ? `The device has not confirmed that its coils are off. ${POWER_OFF_INSTRUCTION}` : v.state === "starting" ? "The device stays off after it starts." : "The coils are off.";
    setText("alert-word", v.stopped.startsWith("by ") ? `Stopped ${v.stopped}.` : `Stopped: ${v.stopped}.`);
    setText("alert-text", `${coils} Ask the participant whether to continue; then press Resume, or end the session below.`);
    return;
  }
  setText("alert-word", v.state === "failed" ? "The session ended." : "The device is off.");
  setText("alert-text", v.state === "failed" ? v.trouble : (v.unconfirmed ? `It has not confirmed that its coils are off. ${POWER_OFF_INSTRUCTION} ` : "") + (last && last.trial === v.trial ? last.reason : "Switch it on again to continue.") + (v.state === "device off" ? " The trial then starts again." : ""));
}

/** List stops, repeats, safety events and early ends of the session, newest first. */
function incidents(): void {
  const { incidents, code } = view!;
  const counts = new Map<string, number>();
  for (const one of incidents) counts.set(one.kind, (counts.get(one.kind) ?? 0) + 1);
  setText("safety-title", code || !incidents.length ? "Stops, repeats and safety events" : "Stops, repeats and safety events of the last session");
  setVisible("safety-count", counts.size > 0);
  setText("safety-count", [...counts].map(([kind, count]) => `${kind}: ${count}`).join(", "));
  const key = JSON.stringify(incidents);
  const list = element("safety");
  if (list.dataset["key"] === key) return;
  list.dataset["key"] = key;
  list.replaceChildren(
    ...(incidents.length ? [...incidents].reverse() : [null]).map((one) => {
      const item = document.createElement("li");
      item.className = one ? "" : "nothing";
      item.textContent = one ? `${formatTimeOfDay(one.at)}, trial ${one.trial}: ${one.kind}${one.text ? `, ${one.text}` : ""}` : "none";
      return item;
    }),
  );
}

/** Format a UTC time as local time of day. */
function formatTimeOfDay(at: string): string {
  const time = new Date(at);
  return Number.isNaN(time.getTime()) ? at : time.toLocaleTimeString("en-GB");
}

function log(): void {
  const answered = view!.log;
  const key = JSON.stringify([answered.length, viewers]);
  if (key === rows) return;
  rows = key;
  element("log").replaceChildren(
    ...[...answered].reverse().map((row) => {
      const line = document.createElement("tr");
      const cells = [row.trial + 1, describePrompt(row), row.answer ?? "place", row.seconds.toFixed(1), [...row.safety, ...(row.repeats ? [`restarted ${row.repeats === 1 ? "once" : `${row.repeats} times`}`] : [])].join(", ")];
      line.append(
        ...cells.map((cell) => {
          const made = document.createElement("td");
          made.textContent = String(cell);
          return made;
        }),
        makeReplayLink(row),
      );
      return line;
    }),
  );
}

/** Cell of a trial's recording: a button that starts a viewer, then a link to it. */
function makeReplayLink({ trial, recording }: Row): HTMLElement {
  const cell = document.createElement("td");
  if (recording === null) return cell;
  const url = viewers[recording];
  if (url) {
    const link = Object.assign(document.createElement("a"), { href: url, target: "_blank", rel: "noopener", textContent: "open" });
    link.ariaLabel = `Open the recording of trial ${trial + 1}`;
    cell.append(link);
    return cell;
  }
  const button = Object.assign(document.createElement("button"), { type: "button", textContent: url === "" ? "starting …" : "view", disabled: url === "" });
  button.ariaLabel = `View the recording of trial ${trial + 1}`;
  button.addEventListener("click", () => {
    showMistake("");
    // Open the tab now: browsers allow it only in response to a click, not when the viewer has started.
    if (connection.send({ do: "view", trial })) tabs.set(recording, window.open("", "_blank"));
  });
  cell.append(button);
  return cell;
}

function paint(): void {
  if (!about) return;
  const prompted = view?.prompt?.set_point;
  drawPlan(pad, { limit: about.limit, places: about.places, pen, ...(prompted ? { prompted } : {}) });
  setText("felt", view?.code && pen ? describeForce(pen) : "");
}

const commands: Record<string, string> = { resume: "resume", repeat: "repeat", skip: "skip", leave: "leave", engage: "engage" };
for (const [id, command] of Object.entries(commands)) {
  element(id).addEventListener("click", () => {
    showMistake("");
    connection.send({ do: command });
  });
}
function stop(): void {
  if (!connection.send({ do: "stop" })) showMistake(`STOP could not be sent. ${POWER_OFF_INSTRUCTION}`);
}
element("stop").addEventListener("click", stop);
element("abort").addEventListener("click", () => {
  setVisible("abort-sure", true);
  element("abort-sure").focus();
  setTimeout(() => setVisible("abort-sure", false), CONFIRM_TIMEOUT_MS);
});
element("abort-sure").addEventListener("click", () => {
  setVisible("abort-sure", false);
  connection.send({ do: "abort" });
});
element("begin").addEventListener("submit", (event) => {
  event.preventDefault();
  showMistake("");
  connection.send({ do: "begin", code: code.value }); // unchanged: the server rejects an invalid code
});
addEventListener("keydown", (event) => {
  if (event.key === "Escape") stop();
});
addEventListener("resize", paint);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);
Object.assign(window, {
  study: {
    get view() {
      return view;
    },
  },
});
