// Main-thread side of the WebSocket worker.

import type { FromSocket, ToSocket } from "./socket.worker";
import { parse, type ForceMap, type Mesh, type PointerMessage, type Rows } from "./wire";
import { socketAddress } from "./address";

export interface Listener {
  onOpen(): void;
  /** `code` and `reason` of the WebSocket close event */
  onClose(code: number, reason: string): void;
  /** `receivedAt`: time of receipt in the worker, on the page's clock [ms] */
  frame(frame: Rows | Mesh | ForceMap, receivedAt: number): void;
  event(event: Record<string, unknown> & { event: string }): void;
}

const RELOAD_INTERVAL_MS = 1000; // until the worker's script is requested again
const HEARTBEAT_INTERVAL_MS = 50; // to the worker

export class Link {
  private worker!: Worker;

  /** `heartbeatTimeout`: without a heartbeat from this page for so long, the stylus is released [ms] */
  constructor(
    private readonly token: string,
    private readonly heartbeatTimeout: number,
    private readonly listener: Listener,
  ) {
    this.open();
    setInterval(() => this.post({ kind: "alive" }), HEARTBEAT_INTERVAL_MS);
  }

  private open(): void {
    const { listener, token, heartbeatTimeout } = this;
    this.worker = new Worker("static/socket.js", { type: "module" });
    let started = false;
    // If the script could not be loaded, try again: without the worker the page has no connection.
    this.worker.onerror = () => started || setTimeout(() => this.open(), RELOAD_INTERVAL_MS);
    this.worker.onmessage = ({ data }: MessageEvent<FromSocket>) => {
      started = true;
      switch (data.kind) {
        case "opened":
          return listener.onOpen();
        case "closed":
          return listener.onClose(data.code, data.reason);
        case "text":
          return listener.event(JSON.parse(data.text) as { event: string });
        case "frame": {
          const frame = parse(data.buffer);
          if (frame) listener.frame(frame, data.receivedAt - performance.timeOrigin);
        }
      }
    };
    this.post({ kind: "open", url: socketAddress("ws"), protocols: ["haptorb", `token.${token}`], heartbeatTimeout });
  }

  point(pointer: PointerMessage): void {
    this.post({ kind: "pointer", pointer });
  }

  /** Release the stylus and discard its pose. */
  drop(): void {
    this.post({ kind: "drop" });
  }

  command(command: Record<string, unknown>): void {
    this.post({ kind: "command", text: JSON.stringify(command) });
  }

  private post(message: ToSocket): void {
    this.worker.postMessage(message);
  }
}
