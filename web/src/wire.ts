// The binary frames between page and server; the server's side of this is `web/wire.py`.

export const MAGIC = 0x484f5242;
export const VERSION = 1;
export const HEADER = 48;
export const Kind = { rows: 1, mesh: 2, forceMap: 3 } as const;

/** A batch of ticks: `count` rows of `width` numbers; t and tick are counted from `t0` and `tick0`. */
export interface Rows {
  kind: "rows";
  count: number;
  width: number;
  t0: number;
  tick0: number;
  /** this page's own time stamp of the pointer event that these rows answer [ms], or NaN */
  echo: number;
  /** rows that this page never got, in total */
  dropped: number;
  data: Float32Array;
}

/** The dome: unit vectors and triangles. */
export interface Mesh {
  kind: "mesh";
  directions: Float32Array;
  triangles: Uint32Array;
}

/** The map: radial force [N] per vertex, and whether the device is at its limit there. */
export interface ForceMap {
  kind: "force map";
  force: Float32Array;
  saturated: Uint8Array;
}

/** What a frame says, or null if it is not one of ours. */
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

/** Where the pointer wants the mover; `stamp` NaN: a refresh that needs no answer. Without `q` the device decides. */
export interface Pointer {
  stamp: number;
  p: readonly [number, number, number];
  q?: readonly [number, number, number, number];
  held: boolean;
}

/** The pointer's message. */
export function pointerMessage({ stamp, p, q, held }: Pointer): ArrayBuffer {
  const numbers = new Float64Array([stamp, ...p, ...(q ?? [NaN, NaN, NaN, NaN]), held ? 1 : 0]);
  return numbers.buffer;
}
