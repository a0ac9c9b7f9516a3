// Binary frames between page and server; must match `haptorb/web/wire.py`.

export const MAGIC = 0x484f5242;
export const VERSION = 1;
export const HEADER = 48;
export const Kind = { rows: 1, mesh: 2, forceMap: 3 } as const;

/** A batch of `count` rows of `width` values; t and tick are relative to `t0` and `tick0`. */
export interface Rows {
  kind: "rows";
  count: number;
  width: number;
  t0: number;
  tick0: number;
  /** the page's time stamp of the pointer event that the newest row responds to [ms]; NaN: none */
  echo: number;
  /** total of rows that were not sent because this page was too slow */
  dropped: number;
  data: Float32Array;
}

/** Mesh of the dome: vertices as unit vectors, and triangles. */
export interface Mesh {
  kind: "mesh";
  directions: Float32Array;
  triangles: Uint32Array;
}

/** Force map: radial force [N] per vertex, and whether a limit is reached there. */
export interface ForceMap {
  kind: "force map";
  force: Float32Array;
  saturated: Uint8Array;
}

/** Decode a frame; null if its header is unknown. */
export function parse(buffer: ArrayBuffer): Rows | Mesh | ForceMap | null {
  if (buffer.byteLength < HEADER) return null;
  const head = new DataView(buffer, 0, HEADER);
  if (head.getUint32(0, true) !== MAGIC || head.getUint16(6, true) !== VERSION) return null;
  const count = head.getUint32(8, true);
  const width = head.getUint32(12, true);
  const numbers = (at: number): number => head.getFloat64(at, true);
  switch (head.getUint16(4, true)) {
    case Kind.rows:
      return {
        kind: "rows",
        count,
        width,
        t0: numbers(16),
        tick0: numbers(24),
        echo: numbers(32),
        dropped: numbers(40),
        data: new Float32Array(buffer, HEADER, count * width),
      };
    case Kind.mesh:
      return {
        kind: "mesh",
        directions: new Float32Array(buffer, HEADER, 3 * count),
        triangles: new Uint32Array(buffer, HEADER + 12 * count, 3 * width),
      };
    case Kind.forceMap:
      return {
        kind: "force map",
        force: new Float32Array(buffer, HEADER, count),
        saturated: new Uint8Array(buffer, HEADER + 4 * count, count),
      };
    default:
      return null;
  }
}

/** Where the hand wants the mover: position [m] and quaternion (x, y, z, w). Without `q` the device's default applies. */
export interface HandGoal {
  p: readonly [number, number, number];
  q?: readonly [number, number, number, number];
}

/** Hand goal from the page's pointer. */
export interface PointerMessage extends HandGoal {
  /** time of the pointer event [ms]; NaN: a repetition without echo */
  stamp: number;
  held: boolean;
}

/** Encode a pointer message. */
export function encodePointerMessage({ stamp, p, q, held }: PointerMessage): ArrayBuffer {
  const numbers = new Float64Array([stamp, ...p, ...(q ?? [NaN, NaN, NaN, NaN]), held ? 1 : 0]);
  return numbers.buffer;
}
