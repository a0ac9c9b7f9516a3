// WebSocket connection to the study's server, with its messages and automatic reconnection.

import { socketAddress } from "../address";

/** Position on the dome [deg]: `theta` from the top, `phi` about it. */
export interface SetPoint {
  number: number;
  theta: number;
  phi: number;
}

/** Description of the study. */
export interface StudyDescription {
  study: string;
  procedure: string;
  instructions: string;
  consent: string;
  simulated: boolean;
  places: SetPoint[];
  limit: number;
  mask: { noise: "pink" | "white"; volume_db: number } | null;
  database?: string;
  pilot?: boolean;
  forecast?: string;
  code?: string;
}

export interface Task {
  kind: "number" | "compare" | "rate" | "place";
  ask: string;
  numbers: number[];
  low?: number;
  high?: number;
  decimal?: boolean; // any number above `low`, not only integers
}

export interface Question {
  name: string;
  text: string;
  choices: string[];
  low: number | null;
  high: number | null;
}

/** State of the session as a page sees it. */
export interface View {
  state: string;
  session: number;
  task: Task | null;
  question: Question | null;
  /** who stopped the session; empty: not stopped */
  stopped: string;
  /** the coils are commanded off, but the device has not confirmed it */
  unconfirmed: boolean;
  resumed?: boolean;
  /** number of stored answers of a session that has ended */
  stored?: number;
  watching?: boolean;
  trial?: number;
  done?: number;
  total?: number;
  left?: number;
  off?: boolean;
  steered?: boolean;
  /** number of restarts of this trial */
  repeats?: number;
  which?: number;
  practice?: boolean;
}

/** Position of the tool seen from above [deg from the top], and the force on it [N]. */
export interface Pen {
  x: number;
  y: number;
  off: boolean;
  out?: number;
  fx?: number;
  fy?: number;
}

export interface Handlers<V extends View> {
  about(about: StudyDescription): void;
  view(view: V): void;
  pen(pen: Pen | null): void;
  showMistake(text: string): void;
  /** viewer addresses by part of the recording; empty string while a viewer starts */
  viewers?(urls: Record<string, string>): void;
  /** the connection was lost, or refused for the reason `refused`: nothing shown is live */
  onClose(refused: string): void;
}

const RECONNECT_INTERVAL_MS = 1000;
const CLOSE_CODE_REFUSED = 1008; // WebSocket policy violation

export class Connection<V extends View> {
  private socket: WebSocket | null = null;

  constructor(
    private readonly path: string,
    private readonly handlers: Handlers<V>,
    private readonly token = "",
  ) {
    this.open();
  }

  /** Send a command; returns false without a connection, because then it is lost. */
  send(command: Record<string, unknown>): boolean {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(command));
    return true;
  }

  private open(): void {
    const socket = new WebSocket(socketAddress(this.path));
    this.socket = socket;
    socket.onopen = () => {
      if (this.token) socket.send(this.token);
    };
    socket.onmessage = (message: MessageEvent<string>) => {
      const line = JSON.parse(message.data) as { event: string; is?: unknown; text?: string };
      if (line.event === "about") this.handlers.about(line as unknown as StudyDescription);
      else if (line.event === "view") this.handlers.view(line.is as V);
      else if (line.event === "pen") this.handlers.pen(line.is as Pen | null);
      else if (line.event === "viewers") this.handlers.viewers?.(line.is as Record<string, string>);
      else if (line.event === "mistake") this.handlers.showMistake(line.text ?? "");
    };
    socket.onclose = (end) => {
      this.handlers.onClose(end.code === CLOSE_CODE_REFUSED ? end.reason : "");
      if (end.code !== CLOSE_CODE_REFUSED) setTimeout(() => this.open(), RECONNECT_INTERVAL_MS);
    };
  }
}

/** Instruction for a stop that could not be sent, or was not confirmed. */
export const POWER_OFF_INSTRUCTION = "Let go of the tool and switch off the device's power.";

export function element<E extends HTMLElement>(id: string): E {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found as E;
}

/** Set text only if it changed, so that screen readers do not repeat it and selections stay. */
export function setText(id: string, text: string): void {
  const place = element(id);
  if (place.textContent !== text) place.textContent = text;
}

export function setVisible(id: string, shown: boolean): void {
  element(id).hidden = !shown;
}
