// WebSocket in a worker, so that the pose of a drag is repeated every 12 ms even while the page is busy drawing.
// A frozen page must not hold a powered stylus: without a heartbeat from the page for `heartbeatTimeout`, the pose is
// discarded; it then expires, and a simulated hand releases the tool.

import { encodePointerMessage, type PointerMessage } from "./wire";

/** message from the page to this worker */
export type ToSocket =
  | { kind: "open"; url: string; protocols: string[]; heartbeatTimeout: number }
  | { kind: "alive" }
  | { kind: "pointer"; pointer: PointerMessage }
  | { kind: "drop" }
  | { kind: "command"; text: string };

/** message from this worker to the page */
export type FromSocket =
  | { kind: "opened" }
  | { kind: "closed"; code: number; reason: string }
  | { kind: "text"; text: string }
  | { kind: "frame"; buffer: ArrayBuffer; receivedAt: number }; // receivedAt [ms since 1970]

const POSE_INTERVAL_MS = 12; // between repetitions of a held pose
const TIMER_TOLERANCE_MS = 2; // by which a timer may fire early
const RECONNECT_INTERVAL_MS = 1000;

interface WorkerScope {
  postMessage(message: FromSocket, transfer?: Transferable[]): void;
  onmessage: ((event: MessageEvent<ToSocket>) => void) | null;
}
const page = self as unknown as WorkerScope;

let socket: WebSocket | null = null;
let held: PointerMessage | null = null;
let sent = 0;
let alive = 0;
let heartbeatTimeout = 0; // [ms]

function send(data: string | ArrayBuffer): void {
  if (socket?.readyState === WebSocket.OPEN) socket.send(data);
}

/** Release the stylus; discard its pose. */
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
    else page.postMessage({ kind: "frame", buffer: data, receivedAt: performance.timeOrigin + performance.now() }, [data]);
  };
  socket.onclose = ({ code, reason }) => {
    held = null;
    page.postMessage({ kind: "closed", code, reason });
    setTimeout(() => open(url, protocols), RECONNECT_INTERVAL_MS);
  };
}

page.onmessage = ({ data: message }) => {
  alive = performance.now();
  switch (message.kind) {
    case "open":
      heartbeatTimeout = message.heartbeatTimeout;
      open(message.url, message.protocols);
      break;
    case "alive":
      break;
    case "pointer":
      send(encodePointerMessage(message.pointer));
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
  if (now - alive >= heartbeatTimeout) drop();
  else if (held && now - sent >= POSE_INTERVAL_MS - TIMER_TOLERANCE_MS) {
    send(encodePointerMessage(held));
    sent = now;
  }
}, POSE_INTERVAL_MS);
