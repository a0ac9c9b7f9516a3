// Overview of a whole recording: minimum and maximum per time bin, and marks.

import type { Recorded } from "./played";

export interface Mark {
  /** time after the first tick of the recording [s] */
  t: number;
  kind: "trip" | "world" | "gap";
  text: string;
}

export interface Ranges {
  least: Float32Array;
  most: Float32Array;
}

export interface Overview {
  /** fraction of the recording that has been read, 0 to 1 */
  done: number;
  trouble: string;
  bins: number;
  /** ranges with unit, by name of the channel */
  ranges: Map<string, Ranges & { unit: string }>;
  marks: Mark[];
}

interface Head {
  done: number;
  rows: number;
  trouble: string;
  bins: number;
  channels: { name: string; unit: string }[];
  events: { kind: Mark["kind"]; t: number; code: number }[];
}

export type Trips = Record<string, { word: string; text: string }>;

/** Fetch the overview as far as the server has computed it. */
export async function fetchOverview(recording: number, token: string, played: Recorded, trips: Trips): Promise<Overview> {
  const answer = await fetch(`api/overview?recording=${recording}`, { headers: { authorization: `Bearer ${token}` } });
  if (!answer.ok) throw new Error(`the server responded with ${answer.status} to /api/overview`);
  const buffer = await answer.arrayBuffer();
  const length = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length))) as Head;
  const { bins } = head;
  const ranges = new Map(
    head.channels.map(({ name, unit }, i) => {
      const at = 4 + length + 8 * i * bins;
      return [name, { unit, least: new Float32Array(buffer, at, bins), most: new Float32Array(buffer, at + 4 * bins, bins) }];
    }),
  );
  const marks = head.events.map(({ kind, t, code }): Mark => ({ kind, t, text: describe(kind, code, played, trips) }));
  marks.sort((a, b) => a.t - b.t);
  return { done: head.rows ? head.done / head.rows : 1, trouble: head.trouble, bins, ranges, marks };
}

function describe(kind: Mark["kind"], code: number, { changes }: Recorded, trips: Trips): string {
  if (kind === "gap") return `${code} ticks missing`;
  if (kind === "world") {
    const [name, before] = [changes[code], changes[code - 1]];
    return name === undefined ? "world changed" : name === before ? `${name}, other values` : `world ${name}`;
  }
  return `trip: ${trips[code] ? reason(trips[code]) : "unknown reason"}`;
}

/** First sentence of the text on a trip. */
const reason = ({ text }: { text: string }): string => text.split(/[.:;]\s/)[0]!.replace(/\.$/, "");
