// Participant's page: instructions, the simulated pen with its force as text, and entry of one confirmed answer.

import { readDecimal, readWhole } from "../entry";
import { POWER_OFF_INSTRUCTION, element, Connection, setText, setVisible, type StudyDescription, type Pen, type Question, type Task, type View } from "./connection";
import { MaskingNoise } from "./masking_noise";
import { drawPlan, describeForce, fromCanvas, toCanvas } from "./plan";

const KEY_STEP_DEG = 3;
const MIN_STEER_INTERVAL_MS = 20; // between positions sent during a drag
const DEFAULT_LIMIT_DEG = 60; // of the workspace, until the server has sent it
const ARROWS: Record<string, [number, number]> = { ArrowUp: [0, KEY_STEP_DEG], ArrowDown: [0, -KEY_STEP_DEG], ArrowLeft: [-KEY_STEP_DEG, 0], ArrowRight: [KEY_STEP_DEG, 0] };

const FINAL_STATES = ["done", "left", "aborted", "declined", "failed"];

let about: StudyDescription | null = null;
const NO_CONNECTION: View = { state: "connecting", session: 0, task: null, question: null, stopped: "", unconfirmed: false };

let view: View = NO_CONNECTION;
let pen: Pen | null = null;
let handGoal: { x: number; y: number } | null = null;
let chosen: number | null = null;
let mask: MaskingNoise | null = null;
let answerKey = ""; // identifies the content of the answer field
let messageKey = ""; // identifies the content of the message
let sentAt = 0;
let steerTimer = 0; // of a move that came too soon after the previous one
let mistake = ""; // shown until the next key
let refusal = ""; // why the server closed this page

const typed = element<HTMLInputElement>("typed");
const pad = element<HTMLCanvasElement>("pad");

const connection = new Connection<View>("ws/participant", {
  about(facts) {
    about = facts;
    mask ??= facts.mask ? new MaskingNoise(facts.mask.noise, facts.mask.volume_db) : null;
    document.title = facts.study;
    setText("study", facts.study);
    setVisible("simulated", facts.simulated);
  },
  view(next) {
    const other = next.trial !== view.trial || next.state !== view.state;
    view = next;
    if (other) showMistake("");
    render();
  },
  pen(next) {
    pen = next;
    paint();
  },
  showMistake,
  onClose(reason) {
    refusal = reason;
    view = NO_CONNECTION;
    pen = handGoal = null;
    mask?.stop();
    render();
  },
}, location.hash.slice(1) || "none");

function inTrial(): boolean {
  return (view.state === "running" || view.state === "time is up") && view.task !== null && !view.watching;
}

function showMistake(text: string): void {
  mistake = text;
  setVisible("mistake", text !== "");
  setText("mistake", text);
  if (text !== "") document.getElementById("mistake")?.scrollIntoView({ block: "nearest" });
}

function render(): void {
  const trial = inTrial();
  setVisible("trial", trial);
  setVisible("message", !trial);
  setVisible("stop", view.state !== "connecting");
  document.body.classList.toggle("stopped", view.stopped !== "");
  const total = view.total ?? 0;
  setVisible("progress", total > 0);
  element<HTMLProgressElement>("progress").max = Math.max(total, 1);
  element<HTMLProgressElement>("progress").value = view.done ?? 0;
  setText("progress-word", total ? `${view.done ?? 0} of ${adaptive() ? "at most " : ""}${total} answered` : "");
  if (trial) renderTrial(view.task!);
  else renderMessage();
}

function adaptive(): boolean {
  return about?.procedure === "staircase";
}

function renderTrial(task: Task): void {
  setText("ask", view.state === "time is up" ? "Time is up: please answer now" : task.ask);
  setVisible("practice", view.practice === true);
  setVisible("pen", view.steered === true);
  const key = `${view.session} ${view.trial} ${view.repeats} ${task.kind}`;
  if (key !== answerKey) {
    answerKey = key;
    messageKey = "";
    choose(null);
    buildAnswers(task);
    setText("polite", `${task.ask} Trial ${(view.trial ?? 0) + 1}${view.repeats ? ", from its beginning" : ""}.`);
    if (task.kind !== "place") typed.focus();
    else element("sure").focus();
  }
  updateIntervals(task);
  const keys = [task.kind === "place" ? "Enter answers" : "type the number, Enter answers", "Space stops"];
  if (view.steered) keys.unshift("arrow keys move the pen", "F reads out the force");
  if (task.kind === "compare") keys.unshift("O switches to the other one");
  setText("keys", keys.join(" · "));
  paint();
}

/** Show buttons and text field for the answer. */
function buildAnswers(task: Task): void {
  const field = element("answers");
  field.replaceChildren();
  field.className = task.kind;
  setVisible("confirm", true);
  setVisible("typed", task.kind !== "place");
  setVisible("typed-label", task.kind !== "place");
  typed.value = "";
  typed.inputMode = task.decimal ? "decimal" : "numeric";
  typed.className = task.decimal || (task.high ?? 0) >= 1000 ? "long" : "";
  setText("typed-label", task.decimal ? `Number above ${task.low ?? 0}` : "Number");
  for (const number of task.numbers) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = String(number);
    button.dataset["number"] = String(number);
    button.setAttribute("aria-pressed", "false");
    const place = task.kind === "number" ? about?.places.find((p) => p.number === number) : undefined;
    if (place && about) {
      const [x, y] = toCanvas(place.theta, place.phi, about.limit);
      button.style.left = `${50 + 50 * x}%`;
      button.style.top = `${50 + 50 * y}%`;
    }
    button.addEventListener("click", () => {
      choose(number);
      element("sure").focus();
    });
    field.append(button);
  }
}

function updateIntervals(task: Task): void {
  const field = element("intervals");
  setVisible("intervals", task.kind === "compare");
  if (task.kind !== "compare") return;
  if (!field.childElementCount) {
    for (const which of [1, 2]) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = `feel ${which}`;
      button.addEventListener("click", () => connection.send({ do: "interval", which }));
      field.append(button);
    }
  }
  [...field.children].forEach((button, n) => button.setAttribute("aria-pressed", String(view.which === n + 1)));
}

/** Set the answer before confirmation; `isTyped`: from the text field, whose text stays as typed. */
function choose(number: number | null, isTyped = false): void {
  chosen = number;
  if (number !== null && !isTyped) typed.value = String(number);
  for (const button of element("answers").children) {
    button.setAttribute("aria-pressed", String((button as HTMLElement).dataset["number"] === String(number)));
  }
  setText("sure", view.task?.kind === "place" ? "Confirm position" : number === null ? "Answer" : `Answer ${number}`);
  // Not `disabled`, so that Enter still shows what is wrong with the number.
  element("sure").setAttribute("aria-disabled", String(view.task?.kind !== "place" && number === null));
  connection.send({ do: "draft", value: number });
}

function isAllowed(number: number): boolean {
  const task = view.task;
  if (!task) return false;
  if (task.numbers.length) return task.numbers.includes(number);
  if (task.decimal) return number > (task.low ?? 0) && number <= (task.high ?? 0);
  return number >= (task.low ?? 0) && number <= (task.high ?? 0);
}

/** Describe the valid answers. */
function describeAllowed(): string {
  const { decimal, low, high, numbers } = view.task!;
  if (decimal) return `a number above ${low ?? 0}, up to ${high}, such as 12.5`;
  const [first, last] = numbers.length ? [numbers[0]!, numbers[numbers.length - 1]!] : [low ?? 0, high ?? 0];
  if (!numbers.length || last - first === numbers.length - 1) return `a whole number from ${first} to ${last}`;
  return `one of the numbers ${numbers.join(", ")}`;
}

// Typed text is never corrected: it is a valid answer, or none.
typed.addEventListener("input", () => {
  const number = view.task?.decimal ? readDecimal(typed.value) : readWhole(typed.value);
  choose(number !== null && isAllowed(number) ? number : null, true);
});

element("confirm").addEventListener("submit", (event) => {
  event.preventDefault();
  if (!inTrial()) return;
  if (view.task?.kind !== "place" && chosen === null) {
    showMistake(typed.value ? `“${typed.value}” is no answer: ${describeAllowed()}. Nothing was stored.` : "Choose the number first.");
    typed.focus();
    return;
  }
  connection.send({ do: "answer", trial: view.trial, value: view.task?.kind === "place" ? null : chosen });
});

function renderMessage(): void {
  const question = view.question ? view.question.name : "";
  const key = `${view.session} ${view.state} ${question} ${view.watching} ${view.stopped} ${view.unconfirmed} ${view.stored} ${refusal}`;
  const state = view.stopped && hasDevice(view.state) ? "paused" : view.watching ? "watching" : view.state;
  if (state === "break") setText("message-text", `${view.left ?? 0} s. Rest your hand.`);
  if (key === messageKey) return;
  messageKey = key;
  answerKey = "";
  const buttons = element("message-buttons");
  buttons.replaceChildren();
  setVisible("mask", mask !== null && state === "consent");
  setText("mask", mask?.state ?? "");
  setText("keys", "");
  const [title, text] = describeState(state);
  setText("message-title", title);
  const place = element("message-text");
  place.replaceChildren(...text.split("\n\n").filter(Boolean).map(paragraph));
  if (state === "consent") {
    const consent = about?.consent ?? "";
    button(consent ? "I agree: begin" : "Begin", "sure", () => {
      mask?.start();
      connection.send({ do: "agree", agreed: true });
    });
    if (consent) button("I do not agree", "", () => connection.send({ do: "agree", agreed: false }));
  } else if (state === "break") {
    setText("message-text", `${view.left ?? 0} s. Rest your hand.`);
    button("Continue now", "sure", () => connection.send({ do: "skip" }));
  } else if (state === "question" && view.question) showQuestion(view.question);
  if (FINAL_STATES.includes(state)) mask?.stop();
  setText("polite", `${title} ${state === "consent" ? "" : text}`);
  (buttons.querySelector("button, input, textarea") as HTMLElement | null)?.focus();

  function button(text: string, kind: string, then: () => void): void {
    const made = document.createElement("button");
    made.type = "button";
    made.textContent = text;
    made.className = kind;
    made.addEventListener("click", then);
    buttons.append(made);
  }
}

/** Whether a device runs or starts in this state. */
function hasDevice(state: string): boolean {
  return !FINAL_STATES.includes(state) && !["connecting", "waiting"].includes(state);
}

/** Describe a stop: who stopped, whether the coils are off, and how to continue. */
function describeStop(): string {
  const who = view.stopped === "by the participant" ? "You stopped the device." : `The device was stopped${view.stopped ? ` (${view.stopped})` : ""}.`;
  const coils = view.unconfirmed ? `It has not confirmed that its coils are off. ${POWER_OFF_INSTRUCTION}` : view.state === "starting" ? "It stays off after it starts." : "Its coils are off.";
  return `${who} ${coils}\n\nNothing continues by itself. To continue, tell the experimenter: only they can press Resume. You may also end the session.`;
}

/** Describe what is stored of an ended session. */
function describeStored(): string {
  if (view.stored === 0) return "No answer was given, and none is stored.";
  return view.stored === 1 ? "Your answer is stored." : "Your answers are stored.";
}

function describeState(state: string): [string, string] {
  switch (state) {
    case "connecting":
      if (refusal) return ["Access refused", refusal];
      return ["No connection", `The study's program does not respond, and STOP on this page does not work now. If you feel a force: ${POWER_OFF_INSTRUCTION.toLowerCase()}\n\nThis page reconnects by itself.`];
    case "waiting":
      return ["Welcome", "Please wait for the experimenter."];
    case "starting":
      return ["One moment", "The device is starting."];
    case "consent":
      return [view.resumed ? "Welcome back" : "Welcome", `${about?.instructions ?? ""}\n\n${about?.consent ?? ""}`];
    case "pause":
      return ["Next trial", ""];
    case "break":
      return ["Break", ""];
    case "device off":
      return ["Please wait", `The device is off; the experimenter sees why. ${view.unconfirmed ? `It has not confirmed that its coils are off. ${POWER_OFF_INSTRUCTION} ` : ""}When it is on again, this trial starts again: answers do not count while it is off.`];
    case "paused":
      return ["Stopped", describeStop()];
    case "question":
      return [view.question?.text ?? "", ""];
    case "watching":
      return ["Another page is open", "Answers are given there. Close it first to answer here. STOP works here as well."];
    case "done":
      return ["Thank you", "All answers are stored."];
    case "left":
      return ["Until next time", describeStored()];
    case "aborted":
      return ["The session has ended", describeStored()];
    case "declined":
      return ["Thank you", `You did not agree to take part, so nothing begins. ${view.stored ? `${describeStored()} Tell the experimenter if they are to be removed.` : "No answer of yours is stored."}`];
    case "failed":
      return ["Something went wrong", `The device was switched off. ${describeStored()} Please call the experimenter.`];
  }
  return ["", ""];
}

function paragraph(text: string): HTMLElement {
  const made = document.createElement("p");
  made.textContent = text;
  return made;
}

/** Show a question: a button per choice, a number, or free text. */
function showQuestion(question: Question): void {
  const place = element("message-buttons");
  const form = document.createElement("form");
  form.className = "question";
  form.addEventListener("submit", (event) => event.preventDefault());
  const reply = (text: string) => connection.send({ do: "reply", question: question.name, reply: text });
  if (question.choices.length) {
    for (const choice of question.choices) {
      const made = document.createElement("button");
      made.type = "button";
      made.textContent = choice;
      made.addEventListener("click", () => reply(choice));
      form.append(made);
    }
  } else {
    const number = question.low !== null;
    const input = document.createElement(number ? "input" : "textarea") as HTMLInputElement | HTMLTextAreaElement;
    input.setAttribute("aria-labelledby", "message-title");
    if (input instanceof HTMLInputElement) {
      input.inputMode = "numeric";
      input.autocomplete = "off";
      input.placeholder = `${question.low} to ${question.high}`;
    } else input.rows = 4;
    const made = document.createElement("button");
    made.className = "sure";
    made.textContent = "Answer";
    form.append(input, made);
    form.addEventListener("submit", () => reply(input.value));
  }
  place.append(form);
}

function paint(): void {
  if (!about || !view.steered || !inTrial()) return;
  drawPlan(pad, { limit: about.limit, places: about.places, handGoal: handGoal ?? undefined, pen });
  setText("felt", describeForce(pen));
}

function steer(x: number, y: number): void {
  const limit = about?.limit ?? DEFAULT_LIMIT_DEG;
  const far = Math.hypot(x, y);
  const scale = far > limit ? limit / far : 1;
  handGoal = { x: x * scale, y: y * scale };
  connection.send({ do: "steer", ...handGoal });
  paint();
}

function stop(): void {
  if (!connection.send({ do: "stop" })) showMistake(`STOP could not be sent. ${POWER_OFF_INSTRUCTION}`);
}

pad.addEventListener("pointerdown", (event) => {
  pad.setPointerCapture(event.pointerId);
  drag(event);
});
pad.addEventListener("pointermove", (event) => {
  if (!pad.hasPointerCapture(event.pointerId)) return;
  if (event.timeStamp - sentAt > MIN_STEER_INTERVAL_MS) drag(event);
  else {
    clearTimeout(steerTimer); // the last move must be sent even if no other follows
    steerTimer = window.setTimeout(() => drag(event), MIN_STEER_INTERVAL_MS);
  }
});
pad.addEventListener("pointerup", drag);

function drag(event: PointerEvent): void {
  clearTimeout(steerTimer);
  if (!about || !inTrial()) return;
  sentAt = event.timeStamp;
  const box = pad.getBoundingClientRect();
  const { x, y } = fromCanvas(pad, event.clientX - box.left, event.clientY - box.top, about.limit);
  steer(x, y);
}

element("stop").addEventListener("click", stop);
addEventListener("resize", paint);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);
addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  const writing = event.target instanceof HTMLTextAreaElement;
  if (mistake && !writing && event.key !== "Enter") showMistake("");
  // In other states the space bar keeps its normal function: press a button, type a space.
  const stops = ["starting", "pause", "break", "device off"].includes(view.state);
  if (event.key === "Escape") stop();
  if (!inTrial()) {
    if (/^[\d-]$/.test(event.key) && ["pause", "device off"].includes(view.state)) showMistake("No trial runs now: this key was not an answer, and nothing was stored.");
    if (event.key === " " && stops && !writing && !(event.target instanceof HTMLInputElement)) {
      event.preventDefault();
      stop();
    }
    return;
  }
  const arrow = ARROWS[event.key];
  if (event.key === " ") {
    event.preventDefault();
    stop();
  } else if (arrow && view.steered) {
    event.preventDefault();
    steer((handGoal?.x ?? pen?.x ?? 0) + arrow[0], (handGoal?.y ?? pen?.y ?? 0) + arrow[1]);
  } else if (event.key.toLowerCase() === "o" && view.task?.kind === "compare") {
    event.preventDefault();
    connection.send({ do: "interval", which: 3 - (view.which ?? 1) });
  } else if (event.key.toLowerCase() === "f" && view.steered && !(event.target === typed && typed.value)) {
    event.preventDefault();
    setText("polite", describeForce(pen));
  } else if (event.key.length === 1 && event.target !== typed && view.task?.kind !== "place") {
    typed.focus(); // which then receives the character
    typed.select();
  }
});
addEventListener("keyup", (event) => {
  if (event.key === " " && !(event.target instanceof HTMLTextAreaElement)) event.preventDefault();
});

declare global {
  interface Window {
    study: unknown;
  }
}
// State of the page, for browser tests and debugging.
window.study = {
  get view() {
    return view;
  },
  get pen() {
    return pen;
  },
  get mask() {
    return mask?.playing ?? null;
  },
};
render();
