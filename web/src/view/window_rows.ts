// The plots' samples: those of the last seconds before the row that is shown, as a running servo would have left them.

import type { History } from "../history";
import type { Rows } from "../wire";
import { BLOCK, type Place, type RowSource } from "./row_source";

export class WindowRows {
  private first = 0;
  private last = -1; // row numbers in the history

  constructor(
    private readonly history: History,
    private readonly source: RowSource,
  ) {}

  /** Everything up to `place`, `rows` of it at most; true if that changed the samples. */
  fill({ row }: Place, rows: number): boolean {
    if (row === this.last) return false;
    if (row > this.last && this.last >= 0 && row - this.last < rows && this.add(this.last + 1, row)) return true;
    return this.renew(row, rows);
  }

  /** A block has come that may be part of it. */
  renew(row: number, rows: number): boolean {
    let first = row;
    const least = Math.max(0, row - rows + 1);
    while (first > least && this.source.block(Math.floor((first - 1) / BLOCK))) {
      first = Math.max(least, Math.floor((first - 1) / BLOCK) * BLOCK);
    }
    if (!this.source.block(Math.floor(row / BLOCK))) return false;
    this.history.clear();
    this.first = first;
    this.last = first - 1;
    this.add(first, row);
    return true;
  }

  /** Whether the history reaches back `rows` from `row`, or to the beginning. */
  reaches(row: number, rows: number): boolean {
    return this.last === row && this.first <= Math.max(0, row - rows + 1);
  }

  forget(): void {
    this.history.clear();
    this.last = -1;
  }

  private add(first: number, last: number): boolean {
    const parts: Rows[] = [];
    for (let row = first; row <= last; ) {
      const frame = this.source.block(Math.floor(row / BLOCK));
      if (!frame) return false;
      const from = row % BLOCK;
      const count = Math.min(frame.count - from, last - row + 1);
      if (count <= 0) return false;
      parts.push({ ...frame, count, data: frame.data.subarray(from * frame.width, (from + count) * frame.width) });
      row += count;
    }
    for (const part of parts) this.history.append(part);
    this.last = last;
    return true;
  }
}
