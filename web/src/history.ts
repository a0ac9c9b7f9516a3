// Samples of the last minute in preallocated arrays of twice that length, which are shifted back when full.

import type { Column } from "./session";
import type { Rows } from "./wire";

export interface Series {
  name: string;
  /** column head in a CSV file, with the unit */
  head: string;
}

export class History {
  readonly series: Series[];
  private readonly time: Float64Array;
  private readonly values: Float32Array[];
  private end = 0;

  constructor(
    readonly columns: Column[],
    readonly capacity = 60_000,
  ) {
    this.series = columns.flatMap(({ name, width, heads }) =>
      Array.from({ length: width }, (_, i) => ({ name: width > 1 ? `${name}[${i}]` : name, head: heads[i]! })),
    );
    this.time = new Float64Array(2 * capacity);
    this.values = this.series.map(() => new Float32Array(2 * capacity));
  }

  get length(): number {
    return Math.min(this.end, this.capacity);
  }

  append({ count, width, t0, tick0, data }: Rows): void {
    const from = Math.max(0, count - this.capacity);
    for (let r = from; r < count; r++) {
      if (this.end === 2 * this.capacity) {
        this.time.copyWithin(0, this.capacity);
        for (const column of this.values) column.copyWithin(0, this.capacity);
        this.end = this.capacity;
      }
      const row = r * width;
      for (let c = 0; c < width; c++) this.values[c]![this.end] = data[row + c]!;
      this.time[this.end] = t0 + data[row]!;
      this.values[1]![this.end] = tick0 + data[row + 1]!;
      this.end++;
    }
  }

  get newest(): number {
    return this.end ? this.time[this.end - 1]! : NaN;
  }

  get oldest(): number {
    return this.end ? this.time[this.end - this.length]! : NaN;
  }

  /** Index range [first, last) of the samples from time `from` to `to` [s]. */
  window(from: number, to: number): [number, number] {
    return [this.search(from), this.search(to + 1e-9)];
  }

  times(first: number, last: number): Float64Array {
    return this.time.subarray(first, last);
  }

  column(index: number, first: number, last: number): Float32Array {
    return this.values[index]!.subarray(first, last);
  }

  /** Index of the first sample at or after time `t` [s]. */
  private search(t: number): number {
    let low = this.end - this.length;
    let high = this.end;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.time[middle]! < t) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /** Remove all samples: the server's clock was restarted. */
  clear(): void {
    this.end = 0;
  }
}
