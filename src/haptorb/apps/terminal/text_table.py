"""Tables that fit: side by side, with heads and texts wrapped, in pages of columns, or one row under the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rich.cells import cell_len

from haptorb.apps.terminal.console import print_text, wrap
from haptorb.apps.terminal.spelling import fit_encoding

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["Column", "TextTable", "print_table"]

_GAP = 2  #: between columns
_NARROW = 22  #: least width of a text that is wrapped beside numbers


@dataclass(frozen=True)
class Column:
    """One column.

    head  what stands in it
    unit  of its numbers; printed behind the head in brackets
    kind  "number": to the right, never wrapped; "text": to the left, wrapped where there is no room; "short": to the
          left, never wrapped; "note": a text that goes under the row's first cell where there is no room; "key": to
          the left, never wrapped, on every page
    """

    head: str
    unit: str = ""
    kind: str = "number"

    @property
    def title(self) -> str:
        """Head and unit.

        >>> Column("peak", "mN").title
        'peak [mN]'
        """
        return f"{self.head} [{self.unit}]".strip() if self.unit else self.head


@dataclass
class TextTable:
    """Columns and rows of what is printed; `title` stands above them."""

    columns: tuple[Column, ...]
    title: str = ""
    rows: list[tuple[str, ...]] = field(default_factory=list)
    ends: set[int] = field(default_factory=set)  #: rows that a blank line follows

    def add_row(self, *cells: str) -> None:
        """One cell for each column."""
        if len(cells) != len(self.columns):
            raise ValueError(f"a row of this table has {len(self.columns)} cells; got {len(cells)}")
        self.rows.append(cells)

    def end_section(self) -> None:
        """Leave a blank line behind the row that came last."""
        self.ends.add(len(self.rows) - 1)


def print_table(console: Console, table: TextTable) -> None:
    """Print `table` within the console's width: no head, unit or number is cut. Empty columns are left out."""
    encoding = console.encoding
    columns = tuple(Column(fit_encoding(c.head, encoding), fit_encoding(c.unit, encoding), c.kind)
                    for c in table.columns)  # fmt: skip
    rows = [tuple(fit_encoding(cell, encoding) for cell in row) for row in table.rows]
    spelled = TextTable(columns, table.title, rows, table.ends)
    spelled = _choose(spelled, [n for n in range(len(columns)) if any(row[n] for row in rows)])
    if table.title:
        print_text(console, table.title, "bold")
    pages = _pages(spelled, console.width)
    for number, page in enumerate(pages):
        if number:
            console.print()
        if page is None:
            _print_stack(console, spelled)
        else:
            _print_grid(console, page)


def _pages(table: TextTable, width: int) -> list[TextTable | None]:
    """What is printed one under the other; None: the rows, each as a list of names and values."""
    for layout in (
        table,
        _wrap_heads(table, 12),
        _wrap_heads(table),
        _wrap_texts(table, width),
        _wrap_texts(_fold_notes(table), width),
    ):
        if layout is not None and _width(layout) <= width:
            return [layout]
    keys = [n for n, column in enumerate(table.columns) if column.kind == "key"]
    if not keys or any(column.kind in ("text", "note") for column in table.columns):
        return [None]
    heads = _wrap_heads(table)
    pages: list[TextTable | None] = []
    chosen: list[int] = []
    for n in [n for n in range(len(heads.columns)) if n not in keys]:
        if chosen and _width(_choose(heads, [*keys, *chosen, n])) > width:
            pages.append(_choose(heads, [*keys, *chosen]))
            chosen = []
        chosen.append(n)
        if _width(_choose(heads, [*keys, n])) > width:
            return [None]
    return [*pages, _choose(heads, [*keys, *chosen])]


def _choose(table: TextTable, which: Sequence[int]) -> TextTable:
    rows = [tuple(row[n] for n in which) for row in table.rows]
    return TextTable(tuple(table.columns[n] for n in which), rows=rows, ends=table.ends)


def _widths(table: TextTable) -> list[int]:
    cells = zip(*table.rows, strict=True) if table.rows else [()] * len(table.columns)
    return [
        max([_widest(column.title), *map(_widest, column_cells)])
        for column, column_cells in zip(table.columns, cells, strict=True)
    ]


def _width(table: TextTable) -> int:
    return sum(_widths(table)) + _GAP * (len(table.columns) - 1)


def _widest(cell: str) -> int:
    return max(map(cell_len, cell.split("\n")))


def _wrap_heads(table: TextTable, least: int = 0) -> TextTable:
    """Heads no wider than their longest word, their cells or `least`."""
    columns = []
    for n, column in enumerate(table.columns):
        words = map(cell_len, column.title.split())
        room = max([least, *words, *(_widest(row[n]) for row in table.rows)])
        columns.append(Column(wrap(column.title, room), kind=column.kind))
    return TextTable(tuple(columns), rows=table.rows, ends=table.ends)


def _wrap_texts(table: TextTable | None, width: int) -> TextTable | None:
    """Texts wrapped into the room that the numbers leave, shared by their lengths; None where that is too little."""
    if table is None:
        return None
    table = _wrap_heads(table)
    widths = _widths(table)
    texts = [n for n, column in enumerate(table.columns) if column.kind in ("text", "note")]
    room = width - _GAP * (len(widths) - 1) - sum(w for n, w in enumerate(widths) if n not in texts)
    for n in sorted(texts, key=lambda n: widths[n]):  # short ones get what they need
        share = room // max(1, sum(widths[k] >= widths[n] for k in texts))
        widths[n] = min(widths[n], share)
        room -= widths[n]
        if widths[n] < min(_NARROW, _widths(table)[n]):
            return None
    if not texts:
        return None
    rows = [
        tuple(_wrap_cell(cell, widths[n]) if n in texts else cell for n, cell in enumerate(row)) for row in table.rows
    ]
    return TextTable(table.columns, rows=rows, ends=table.ends)


def _wrap_cell(cell: str, width: int) -> str:
    """Lines that begin with spaces keep them when they are wrapped."""
    lines = []
    for line in cell.split("\n"):
        margin = " " * (len(line) - len(line.lstrip()))
        body = wrap(line.lstrip(), width - len(margin)).split("\n")
        lines += [margin + part for part in body]
    return "\n".join(lines)


def _fold_notes(table: TextTable) -> TextTable | None:
    """Notes under the first cell of their row, as `head: text`; None without notes."""
    notes = [n for n, column in enumerate(table.columns) if column.kind == "note"]
    if not notes:
        return None
    stay = [n for n in range(len(table.columns)) if n not in notes]
    rows = []
    for row in table.rows:
        texts = [f"{table.columns[n].title}: {row[n]}".removeprefix(": ") for n in notes if row[n]]
        first = "\n".join([row[stay[0]], *(f"  {line}" for line in texts)])
        rows.append((first, *(row[n] for n in stay[1:])))
    first_column = Column(table.columns[stay[0]].title, kind="text")
    return TextTable((first_column, *(table.columns[n] for n in stay[1:])), rows=rows, ends=table.ends)


def _print_grid(console: Console, table: TextTable) -> None:
    from rich.box import Box
    from rich.table import Table
    from rich.text import Text

    ascii_only = not console.encoding.startswith("utf")
    rule = " -- " if ascii_only else " ── "
    box = Box("\n".join(["    ", "    ", rule, *["    "] * 5]), ascii=ascii_only)
    grid = Table(box=box, padding=(0, _GAP - 1, 0, 0), pad_edge=False, show_edge=False, header_style="bold")
    for column in table.columns:
        grid.add_column(Text(column.title), justify="right" if column.kind == "number" else "left", no_wrap=True,
                        vertical="top")  # fmt: skip
    for n, row in enumerate(table.rows):
        grid.add_row(*map(Text, row))
        if n in table.ends and n + 1 < len(table.rows):
            grid.add_row(*("" for _ in row))
    console.print(grid, soft_wrap=False)


def _print_stack(console: Console, table: TextTable) -> None:
    """Each row by itself: its first cell as a title, then the others under it with their heads."""
    last = [""] * len(table.columns)
    for row in table.rows:
        # A key that is left out is that of the row above.
        last = [cell or before if c.kind == "key" else cell
                for cell, before, c in zip(row, last, table.columns, strict=True)]  # fmt: skip
        first, *others = zip(table.columns, last, strict=True)
        title = f"{first[0].title} {first[1]}" if first[0].unit else first[1]
        print_text(console, wrap(title, console.width, "  "), "bold")
        for column, cell in others:
            if cell:
                text = f"{column.title}: {cell}" if column.title else cell
                print_text(console, wrap(f"  {text}", console.width, "    "))
