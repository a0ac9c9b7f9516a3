// The socket lives in a thread of its own, so that a drag is refreshed every 12 ms however busy the page is drawing;
// but only while the page proves that it is alive: a frozen page must not hold a powered stylus. After `patience` without
// a sign of life the pose is dropped: it expires, or a simulated hand lets go.

import { pointerMessage, type Pointer } from "./wire";

/** from the page to this worker */
export type ToSocket =
  | { kind: "open"; url: string; protocols: string[]; patience: number }
  | { kind: "alive" }
  | { kind: "pointer"; pointer: Pointer }
  | { kind: "drop" }
  | { kind: "command"; text: string };

/** from this worker to the page */
export type FromSocket =
  | { kind: "opened" }
  | { kind: "closed"; code: number; reason: string }
  | { kind: "text"; text: string }
  | { kind: "frame"; buffer: ArrayBuffer; came: number }; // came: when it did [ms since 1970]

const REFRESH = 12; // ms between two refreshes of a held pointer
const RETRY = 1000; // ms between two attempts to come back

interface WorkerScope {
  postMessage(message: FromSocket, transfer?: Transferable[]): void;
  onmessage: ((event: MessageEvent<ToSocket>) => void) | null;
}
const page = self as unknown as WorkerScope;

let socket: WebSocket | null = null;
let held: Pointer | null = null;
let sent = 0;
let alive = 0;
let patience = 0; // ms without a sign of life after which the page counts as frozen

function send(data: string | ArrayBuffer): void {
  if (socket?.readyState === WebSocket.OPEN) socket.send(data);
}

/** Nobody holds the stylus any more, and it rests nowhere. */
function drop(): void {
  if (held) send(JSON.stringify({ do: "drop" }));
  held = null;
}

function open(url: string, protocols: string[]): void {
  socket = new WebSocket(url, protocols);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => page.postMessage({ kind: "opened" });
  socket.onmessage = ({ data }: MessageEvent<string | ArrayBuffer>) => {
    if (typeof data === "string") page.postMessage({ kind: "text", text: data });
    else page.postMessage({ kind: "frame", buffer: data, came: performance.timeOrigin + performance.now() }, [data]);
  };
  socket.onclose = ({ code, reason }) => {
    held = null;
    page.postMessage({ kind: "closed", code, reason });
    setTimeout(() => open(url, protocols), RETRY);
  };
}

page.onmessage = ({ data: message }) => {
  alive = performance.now();
  switch (message.kind) {
    case "open":
      patience = message.patience;
      open(message.url, message.protocols);
      break;
    case "alive":
      break;
    case "pointer":
      send(pointerMessage(message.pointer));
      sent = alive;
      held = message.pointer.held ? { ...message.pointer, stamp: NaN } : null;
      break;
    case "drop":
      drop();
      break;
    case "command":
      send(message.text);
      break;
  }
};

setInterval(() => {
  const now = performance.now();
  if (now - alive >= patience) drop();
  else if (held && now - sent >= REFRESH - 2) {
    send(pointerMessage(held));
    sent = now;
  }
}, REFRESH);
