// The rows of one recording, asked for by time or in blocks of a thousand; blocks are kept while there is room.

import { parse, type ForceMap, type Mesh, type Rows } from "../wire";

export const BLOCK = 1000; // rows
const ROOM = 48e6; // bytes of blocks that are kept
const AT_ONCE = 2; // blocks that are on their way
const ROWS_AT_ONCE = 3; // single rows: a frame need not wait for the answer to the one before
const NEAR = 2e-6; // s: times come as float32 from the first of a block, and a tick's own time must find it
const RETRY = 1000; // ms between two attempts to come back

export interface Answers {
  onOpen(): void;
  onClose(code: number): void;
  /** one row: a frame with it alone, and its number */
  row(frame: Rows, number: number): void;
  block(number: number): void;
  picture(frame: Mesh | ForceMap): void;
  event(event: Record<string, unknown> & { event: string }): void;
}

/** A row of a block that is here. */
export interface Place {
  frame: Rows;
  /** its number in the block, and in the recording */
  index: number;
  row: number;
}

export class RowSource {
  private socket: WebSocket | null = null;
  private questions = 0;
  private readonly asked = new Map<number, number | "at">();
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
    private readonly answers: Answers,
  ) {
    this.open();
  }

  /** Ask for the row at `t` seconds after the first; of several questions only the last is asked. */
  at(t: number): void {
    this.time = t;
    this.pump();
  }

  /** Fetch these blocks, in this order, and no others any more. */
  want(blocks: number[]): void {
    this.wanted = blocks.filter((k) => k >= 0 && k * BLOCK < this.rows && !this.blocks.has(k));
    this.pump();
  }

  world(change: number, model: string): void {
    this.send({ do: "world", change, model });
  }

  /** The block with that number, if it is here. */
  block(number: number): Rows | undefined {
    return this.blocks.get(number);
  }

  /** The last row that is not later than `t` [s after the first], if its block is here. */
  find(t: number): Place | null {
    const time = this.start + t + NEAR;
    for (const [number, frame] of this.blocks) {
      const { count, t0, width, data } = frame;
      if (time < t0) continue;
      const next = this.blocks.get(number + 1);
      const last = (number + 1) * BLOCK >= this.rows;
      if (!last && time >= (next ? next.t0 : t0 + data[(count - 1) * width]!)) {
        // Of a block whose successor is not here, the last row's own time is the end.
        continue;
      }
      let low = 0;
      let high = count;
      while (high - low > 1) {
        const middle = (low + high) >> 1;
        if (t0 + data[middle * width]! <= time) low = middle;
        else high = middle;
      }
      return { frame, index: low, row: number * BLOCK + low };
    }
    return null;
  }

  /** The row with that number, if its block is here. */
  row(number: number): Place | null {
    const frame = this.blocks.get(Math.floor(number / BLOCK));
    const index = number % BLOCK;
    return frame && index >= 0 && index < frame.count ? { frame, index, row: number } : null;
  }

  private open(): void {
    const socket = new WebSocket(this.url, ["haptorb", `token.${this.token}`]);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.asked.clear();
      this.answers.onOpen();
      this.pump();
    };
    socket.onmessage = ({ data }: MessageEvent<string | ArrayBuffer>) => {
      if (typeof data === "string") this.tell(JSON.parse(data) as { event: string });
      else this.take(data);
    };
    socket.onclose = ({ code }) => {
      this.answers.onClose(code);
      setTimeout(() => this.open(), RETRY);
    };
  }

  private tell(event: Record<string, unknown> & { event: string }): void {
    if (event.event === "mistake") this.asked.delete(Number(event["n"]));
    this.answers.event(event);
    this.pump();
  }

  private take(buffer: ArrayBuffer): void {
    const frame = parse(buffer);
    if (!frame) return;
    if (frame.kind !== "rows") return this.answers.picture(frame);
    const what = this.asked.get(frame.echo);
    this.asked.delete(frame.echo);
    if (what === "at") this.answers.row(frame, frame.dropped);
    else if (what !== undefined) {
      this.keep(what, frame);
      this.answers.block(what);
    }
    this.pump();
  }

  private keep(number: number, frame: Rows): void {
    this.blocks.set(number, frame);
    this.bytes += frame.data.byteLength;
    for (const [old, { data }] of this.blocks) {
      if (this.bytes <= ROOM || old === number) break;
      this.blocks.delete(old);
      this.bytes -= data.byteLength;
    }
  }

  private pump(): void {
    if (this.socket?.readyState !== WebSocket.OPEN) return;
    const asked = [...this.asked.values()];
    if (this.time !== null && asked.filter((what) => what === "at").length < ROWS_AT_ONCE) {
      this.ask("at", { do: "at", t: this.time });
      this.time = null;
    }
    let free = AT_ONCE - asked.filter((what) => what !== "at").length;
    while (free > 0 && this.wanted.length) {
      const number = this.wanted.shift()!;
      if (this.blocks.has(number) || asked.includes(number)) continue;
      this.ask(number, { do: "rows", first: number * BLOCK, count: Math.min(BLOCK, this.rows - number * BLOCK) });
      free--;
    }
  }

  private ask(what: number | "at", question: Record<string, unknown>): void {
    this.questions++;
    this.asked.set(this.questions, what);
    this.send({ ...question, n: this.questions });
  }

  private send(question: Record<string, unknown>): void {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(question));
  }
}
