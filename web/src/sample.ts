// One row of the servo, with access by column name, and vector helpers.

import type { Column } from "./session";

export type Vector = [number, number, number];

export class Sample {
  readonly width: number;
  readonly row: Float32Array;
  t = 0;
  private readonly at: Map<string, Column>;

  constructor(readonly columns: Column[]) {
    this.at = new Map(columns.map((column) => [column.name, column]));
    this.width = columns.reduce((sum, column) => sum + column.width, 0);
    this.row = new Float32Array(this.width).fill(NaN);
  }

  offset(name: string): number {
    const column = this.at.get(name);
    if (!column) throw new Error(`the server's rows have no column '${name}'`);
    return column.offset;
  }

  number(name: string): number {
    return this.row[this.offset(name)]!;
  }

  /** Three consecutive values of a column, starting at index `from`. */
  vector(name: string, from = 0): Vector {
    const i = this.offset(name) + from;
    return [this.row[i]!, this.row[i + 1]!, this.row[i + 2]!];
  }

  quaternion(name: string): [number, number, number, number] {
    const i = this.offset(name);
    return [this.row[i]!, this.row[i + 1]!, this.row[i + 2]!, this.row[i + 3]!];
  }

  list(name: string): Float32Array {
    const column = this.at.get(name)!;
    return this.row.subarray(column.offset, column.offset + column.width);
  }

  /** Set all values to NaN, so that no stale value is shown as live. */
  forget(): void {
    this.row.fill(NaN);
  }
}

export const norm = (v: readonly number[]): number => Math.hypot(v[0]!, v[1]!, v[2]!);
export const dot = (a: readonly number[], b: readonly number[]): number =>
  a[0]! * b[0]! + a[1]! * b[1]! + a[2]! * b[2]!;

/** Spherical coordinates of a vector: tilt from +z and azimuth [deg], and length. */
export function spherical(v: Vector): { tilt: number; azimuth: number; length: number } {
  const length = norm(v);
  return {
    tilt: (Math.acos(Math.min(1, Math.max(-1, v[2] / length))) * 180) / Math.PI,
    azimuth: (Math.atan2(v[1], v[0]) * 180) / Math.PI,
    length,
  };
}

/** Unit vector with this tilt and azimuth [deg]. */
export function direction(tilt: number, azimuth: number): Vector {
  const t = (tilt * Math.PI) / 180;
  const a = (azimuth * Math.PI) / 180;
  return [Math.sin(t) * Math.cos(a), Math.sin(t) * Math.sin(a), Math.cos(t)];
}
