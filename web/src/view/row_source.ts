// Rows of one recording, requested from the server by time or in blocks, with a cache of blocks.

import { parse, type ForceMap, type Mesh, type Rows } from "../wire";

export const BLOCK_ROWS = 1000;
const MAX_CACHE_BYTES = 48e6;
const MAX_BLOCK_REQUESTS = 2; // in flight
const MAX_ROW_REQUESTS = 3; // in flight, so that a frame need not wait for the previous response
const TIME_TOLERANCE_S = 2e-6; // rounding of times, which are float32 relative to the first row of a block
const RECONNECT_INTERVAL_MS = 1000;

export interface RowSourceHandlers {
  onOpen(): void;
  onClose(code: number): void;
  /** frame with a single row, and the row's number */
  row(frame: Rows, number: number): void;
  block(number: number): void;
  picture(frame: Mesh | ForceMap): void;
  event(event: Record<string, unknown> & { event: string }): void;
}

/** Location of a row in a loaded frame. */
export interface RowLocation {
  frame: Rows;
  /** index in the frame, and number in the recording */
  index: number;
  row: number;
}

export class RowSource {
  private socket: WebSocket | null = null;
  private requestCount = 0;
  private readonly pending = new Map<number, number | "at">();
  private readonly blocks = new Map<number, Rows>();
  private bytes = 0;
  private time: number | null = null;
  private wanted: number[] = [];

  constructor(
    private readonly url: string,
    private readonly token: string,
    /** rows of the recording, and the time of the first on the loop's clock [s] */
    private readonly rows: number,
    private readonly start: number,
    private readonly handlers: RowSourceHandlers,
  ) {
    this.open();
  }

  /** Request the row at `t` [s] after the first; a newer request replaces a waiting one. */
  requestRow(t: number): void {
    this.time = t;
    this.sendRequests();
  }

  /** Request these blocks in this order, instead of those that still wait. */
  requestBlocks(blocks: number[]): void {
    this.wanted = blocks.filter((k) => k >= 0 && k * BLOCK_ROWS < this.rows && !this.blocks.has(k));
    this.sendRequests();
  }

  world(change: number, model: string): void {
    this.send({ do: "world", change, model });
  }

  /** Block by number, if it is loaded. */
  block(number: number): Rows | undefined {
    return this.blocks.get(number);
  }

  /** Last row at or before time `t` [s] after the first, if its block is loaded. */
  find(t: number): RowLocation | null {
    const time = this.start + t + TIME_TOLERANCE_S;
    for (const [number, frame] of this.blocks) {
      const { count, t0, width, data } = frame;
      if (time < t0) continue;
      const next = this.blocks.get(number + 1);
      const last = (number + 1) * BLOCK_ROWS >= this.rows;
      if (!last && time >= (next ? next.t0 : t0 + data[(count - 1) * width]!)) {
        // Without the next block it is unknown how long the last row is valid, so the block ends at that row.
        continue;
      }
      let low = 0;
      let high = count;
      while (high - low > 1) {
        const middle = (low + high) >> 1;
        if (t0 + data[middle * width]! <= time) low = middle;
        else high = middle;
      }
      return { frame, index: low, row: number * BLOCK_ROWS + low };
    }
    return null;
  }

  /** Row by number, if its block is loaded. */
  row(number: number): RowLocation | null {
    const frame = this.blocks.get(Math.floor(number / BLOCK_ROWS));
    const index = number % BLOCK_ROWS;
    return frame && index >= 0 && index < frame.count ? { frame, index, row: number } : null;
  }

  private open(): void {
    const socket = new WebSocket(this.url, ["haptorb", `token.${this.token}`]);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.pending.clear();
      this.handlers.onOpen();
      this.sendRequests();
    };
    socket.onmessage = ({ data }: MessageEvent<string | ArrayBuffer>) => {
      if (typeof data === "string") this.onEvent(JSON.parse(data) as { event: string });
      else this.onFrame(data);
    };
    socket.onclose = ({ code }) => {
      this.handlers.onClose(code);
      setTimeout(() => this.open(), RECONNECT_INTERVAL_MS);
    };
  }

  private onEvent(event: Record<string, unknown> & { event: string }): void {
    if (event.event === "mistake") this.pending.delete(Number(event["n"]));
    this.handlers.event(event);
    this.sendRequests();
  }

  private onFrame(buffer: ArrayBuffer): void {
    const frame = parse(buffer);
    if (!frame) return;
    if (frame.kind !== "rows") return this.handlers.picture(frame);
    const what = this.pending.get(frame.echo);
    this.pending.delete(frame.echo);
    if (what === "at") this.handlers.row(frame, frame.dropped);
    else if (what !== undefined) {
      this.cache(what, frame);
      this.handlers.block(what);
    }
    this.sendRequests();
  }

  private cache(number: number, frame: Rows): void {
    this.blocks.set(number, frame);
    this.bytes += frame.data.byteLength;
    for (const [old, { data }] of this.blocks) {
      if (this.bytes <= MAX_CACHE_BYTES || old === number) break;
      this.blocks.delete(old);
      this.bytes -= data.byteLength;
    }
  }

  private sendRequests(): void {
    if (this.socket?.readyState !== WebSocket.OPEN) return;
    const pending = [...this.pending.values()];
    if (this.time !== null && pending.filter((what) => what === "at").length < MAX_ROW_REQUESTS) {
      this.request("at", { do: "at", t: this.time });
      this.time = null;
    }
    let free = MAX_BLOCK_REQUESTS - pending.filter((what) => what !== "at").length;
    while (free > 0 && this.wanted.length) {
      const number = this.wanted.shift()!;
      if (this.blocks.has(number) || pending.includes(number)) continue;
      this.request(number, { do: "rows", first: number * BLOCK_ROWS, count: Math.min(BLOCK_ROWS, this.rows - number * BLOCK_ROWS) });
      free--;
    }
  }

  private request(what: number | "at", message: Record<string, unknown>): void {
    this.requestCount++;
    this.pending.set(this.requestCount, what);
    this.send({ ...message, n: this.requestCount });
  }

  private send(message: Record<string, unknown>): void {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }
}
