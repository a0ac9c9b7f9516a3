// The page's end of the socket's thread.

import type { FromSocket, ToSocket } from "./socket.worker";
import { parse, type ForceMap, type Mesh, type Pointer, type Rows } from "./wire";
import { socketAddress } from "./address";

export interface Listener {
  onOpen(): void;
  /** `code` and `reason` as the server gave them */
  onClose(code: number, reason: string): void;
  /** `came`: when the socket had it, on the page's clock [ms] */
  frame(frame: Rows | Mesh | ForceMap, came: number): void;
  event(event: Record<string, unknown> & { event: string }): void;
}

const RETRY = 1000; // ms until the socket's thread is loaded again
const BEAT = 50; // ms between two signs of life to the socket's thread

export class Link {
  private worker!: Worker;

  /** `patience`: after so long without a sign of life from this page its hold on the stylus ends [ms] */
  constructor(
    private readonly token: string,
    private readonly patience: number,
    private readonly listener: Listener,
  ) {
    this.open();
    setInterval(() => this.post({ kind: "alive" }), BEAT);
  }

  private open(): void {
    const { listener, token, patience } = this;
    this.worker = new Worker("static/socket.js", { type: "module" });
    let begun = false;
    // The file did not come; without it the page would wait forever.
    this.worker.onerror = () => begun || setTimeout(() => this.open(), RETRY);
    this.worker.onmessage = ({ data }: MessageEvent<FromSocket>) => {
      begun = true;
      switch (data.kind) {
        case "opened":
          return listener.onOpen();
        case "closed":
          return listener.onClose(data.code, data.reason);
        case "text":
          return listener.event(JSON.parse(data.text) as { event: string });
        case "frame": {
          const frame = parse(data.buffer);
          if (frame) listener.frame(frame, data.came - performance.timeOrigin);
        }
      }
    };
    this.post({ kind: "open", url: socketAddress("ws"), protocols: ["haptorb", `token.${token}`], patience });
  }

  point(pointer: Pointer): void {
    this.post({ kind: "pointer", pointer });
  }

  /** The hold on the stylus ends here and now: its pose expires. */
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
