// Fills the history with the samples before the shown row, as if a servo had just produced them.

import type { History } from "../history";
import type { Rows } from "../wire";
import { BLOCK_ROWS, type RowLocation, type RowSource } from "./row_source";

export class WindowRows {
  private first = 0;
  private last = -1; // numbers of the first and last row in the history

  constructor(
    private readonly history: History,
    private readonly source: RowSource,
  ) {}

  /** Fill the history up to this row with at most `rows` samples; returns whether it changed. */
  fill({ row }: RowLocation, rows: number): boolean {
    if (row === this.last) return false;
    if (row > this.last && this.last >= 0 && row - this.last < rows && this.add(this.last + 1, row)) return true;
    return this.renew(row, rows);
  }

  /** Fill the history again, for instance after a block was loaded. */
  renew(row: number, rows: number): boolean {
    let first = row;
    const least = Math.max(0, row - rows + 1);
    while (first > least && this.source.block(Math.floor((first - 1) / BLOCK_ROWS))) {
      first = Math.max(least, Math.floor((first - 1) / BLOCK_ROWS) * BLOCK_ROWS);
    }
    if (!this.source.block(Math.floor(row / BLOCK_ROWS))) return false;
    this.history.clear();
    this.first = first;
    this.last = first - 1;
    this.add(first, row);
    return true;
  }

  /** Whether the history has `rows` samples up to `row`, or all since the beginning. */
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
      const frame = this.source.block(Math.floor(row / BLOCK_ROWS));
      if (!frame) return false;
      const from = row % BLOCK_ROWS;
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
