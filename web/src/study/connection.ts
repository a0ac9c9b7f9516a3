// The connection to the study's server: what it says, and that it is there. It comes back by itself.

import { socketAddress } from "../address";

export interface Place {
  number: number;
  theta: number;
  phi: number;
}

export interface About {
  study: string;
  procedure: string;
  instructions: string;
  consent: string;
  simulated: boolean;
  places: Place[];
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
  decimal?: boolean; // any number above low, not only a whole one
}

export interface Question {
  name: string;
  text: string;
  choices: string[];
  low: number | null;
  high: number | null;
}

export interface View {
  state: string;
  session: number;
  task: Task | null;
  question: Question | null;
  /** who stopped; empty: nobody did, or somebody has resumed since */
  stopped: string;
  /** the coils are commanded off, and the device has not confirmed it */
  unconfirmed: boolean;
  resumed?: boolean;
  /** answers that are stored of a session that has ended */
  stored?: number;
  watching?: boolean;
  trial?: number;
  done?: number;
  total?: number;
  left?: number;
  off?: boolean;
  steered?: boolean;
  /** how often this trial was restarted */
  repeats?: number;
  which?: number;
  practice?: boolean;
}

/** Where the tool is [deg from the top, seen from above] and the force on it [N]. */
export interface Pen {
  x: number;
  y: number;
  off: boolean;
  out?: number;
  fx?: number;
  fy?: number;
}

export interface Handlers<V extends View> {
  about(about: About): void;
  view(view: V): void;
  pen(pen: Pen | null): void;
  showMistake(text: string): void;
  /** where recorded trials are played, by their part of the recording; empty while a viewer starts */
  viewers?(urls: Record<string, string>): void;
  /** nothing that is shown may be taken for live any more */
  onClose(refused: string): void;
}

const AGAIN = 1000; // ms

export class Connection<V extends View> {
  private socket: WebSocket | null = null;

  constructor(
    private readonly path: string,
    private readonly handlers: Handlers<V>,
    private readonly token = "",
  ) {
    this.open();
  }

  /** Whether it was sent: without a connection nobody handlers it. */
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
      if (line.event === "about") this.handlers.about(line as unknown as About);
      else if (line.event === "view") this.handlers.view(line.is as V);
      else if (line.event === "pen") this.handlers.pen(line.is as Pen | null);
      else if (line.event === "viewers") this.handlers.viewers?.(line.is as Record<string, string>);
      else if (line.event === "mistake") this.handlers.showMistake(line.text ?? "");
    };
    socket.onclose = (end) => {
      this.handlers.onClose(end.code === 1008 ? end.reason : "");
      if (end.code !== 1008) setTimeout(() => this.open(), AGAIN);
    };
  }
}

/** What to do when a Stop could not be sent, or was not confirmed. */
export const BY_HAND = "Let go of the tool and switch off the device's power.";

export function element<E extends HTMLElement>(id: string): E {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found as E;
}

/** Set text only where it changed: screen readers and selections are left in peace. */
export function say(id: string, text: string): void {
  const place = element(id);
  if (place.textContent !== text) place.textContent = text;
}

export function show(id: string, shown: boolean): void {
  element(id).hidden = !shown;
}
