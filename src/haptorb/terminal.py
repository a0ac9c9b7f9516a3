"""Terminal output of all commands: text, facts, tables and JSON, adapted to the terminal's width and encoding."""

from __future__ import annotations

import codecs
import inspect
import json
import os
import re
import shutil
import sys
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from io import TextIOBase
from queue import SimpleQueue
from threading import RLock, Thread, Timer
from time import sleep
from typing import TYPE_CHECKING, Any, TextIO, cast, final

import typer
from rich.cells import cell_len
from typer.core import TyperCommand, TyperGroup

from haptorb.errors import quote
from haptorb.files import visible

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress
    from rich.status import Status

__all__ = [
    "Column",
    "CommandLine",
    "TextTable",
    "announce_wait",
    "drop_output",
    "echo",
    "find_width",
    "fit_encoding",
    "format_facts",
    "make_console",
    "make_progress",
    "notify",
    "open_output",
    "print_facts",
    "print_file",
    "print_json",
    "print_table",
    "print_text",
    "queue_output",
    "show_status",
    "use_ascii_fallback",
    "wrap",
]


# --------------------------------------------------------------------------------------------------
# Greek letters, symbols and superscripts in ASCII, for outputs whose encoding lacks them.


_HANDLER = "haptorb.ascii"

#: symbol → ASCII, where neither its name nor its decomposition gives it
_SIGNS = {
    "°": "deg", "℃": "degC", "Ω": "Ohm", "µ": "u", "μ": "u", "·": ".", "⋅": ".", "×": "x", "−": "-", "–": "-",
    "—": "-", "±": "+/-", "∓": "-/+", "≤": "<=", "≥": ">=", "≪": "<<", "≫": ">>", "≈": "~", "≠": "!=", "√": "sqrt",
    "∞": "inf", "∂": "d", "∇": "grad", "∫": "integral", "∮": "integral", "∈": "in", "‖": "||", "…": "...",
    "½": "1/2", "‰": " per mille", "§": "section ", "′": "'", "‘": "'", "’": "'", "“": '"', "”": '"', "„": '"',
    "•": "*", "◆": "o", "→": "->", "←": "<-", "↦": "->", "↑": "up", "↓": "down", "↗": "NE", "↖": "NW", "↙": "SW",
    "↘": "SE", "‾": "", "ℓ": "l", "€": "EUR", "█": "#", "━": "=", "─": "-", "│": "|", "├": "+", "└": "+", "┐": "+",
    "╭": "+", "╮": "+", "╯": "+", "╰": "+", "▶": ">",
}  # fmt: skip
_SCRIPTS = {"<super>": "^", "<sub>": "_"}


def fit_encoding(text: str, encoding: str) -> str:
    r"""Replace by ASCII the characters of `text` that `encoding` lacks, and make visible those that control a terminal:
    all output passes through here, as it may contain text from untrusted files.

    >>> fit_encoding("2 µΩ", "latin-1")
    '2 µOhm'
    >>> fit_encoding("θ = 30°, 2.5 µm², R ≤ 0.6 Ω → l̄ (Zárate)", "ascii")
    'theta = 30deg, 2.5 um^2, R <= 0.6 Ohm -> l (Zarate)'
    >>> print(fit_encoding("a recording called \x1b[2J", "utf-8"))
    a recording called \x1b[2J
    """
    text = visible(text)
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        return "".join(letter if _can_encode(encoding, letter) else _spell(letter) for letter in text)
    return text


def use_ascii_fallback() -> None:
    """Let standard output and error replace characters that their encoding lacks, instead of failing."""
    codecs.register_error(_HANDLER, _replace)
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None and not (stream.encoding or "").lower().startswith("utf"):
            reconfigure(errors=_HANDLER)


def _replace(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_spell, error.object[error.start : error.end])), error.end


def _can_encode(encoding: str, letter: str) -> bool:
    try:
        letter.encode(encoding)
    except UnicodeEncodeError:
        return False
    return True


def _spell(letter: str) -> str:
    if letter.isascii():
        return letter
    if letter in _SIGNS:
        return _SIGNS[letter]
    if unicodedata.combining(letter):
        return ""
    name = unicodedata.name(letter, "")
    if name.startswith("GREEK"):
        word = name.split()[-1 if "LETTER" in name else 1].lower().replace("lamda", "lambda")
        return word.capitalize() if "CAPITAL" in name else word
    kind, *_ = unicodedata.decomposition(letter).split()[:1] or [""]
    plain = "".join(_SIGNS.get(part, part) for part in unicodedata.normalize("NFKD", letter))
    return _SCRIPTS.get(kind, "") + plain.encode("ascii", "ignore").decode() or "?"


# --------------------------------------------------------------------------------------------------
# Consoles, and text and JSON on them.


_HARD = "\N{NO-BREAK SPACE}"
_TOGETHER = re.compile(
    r"\[(?:default|required)[^]]*\]"
    r"|`haptorb [^`\n]*`"  # a command is copied in one piece
    r"|[\d.] (?:%|×|±|°C?|1/s|[nµmkMG]?(?:N|m|s|A|V|W|Ω|Hz|T|g|K|J|B)[²³]?(?:[·/][\w·/²]+)?)(?![\w])"
)


def make_console(*, error: bool = False) -> Console:
    """Create a console on standard output, or standard error.

    Text is wrapped at the width of a terminal, or at COLUMNS; in a pipe or a file it is not wrapped.
    """
    from rich.console import Console

    wraps = _has_width(sys.stderr if error else sys.stdout)
    return Console(stderr=error, markup=False, emoji=False, highlight=False, soft_wrap=not wraps)


def find_width() -> int:
    """Return the width of the terminal, or COLUMNS; 80 if neither is known."""
    return shutil.get_terminal_size().columns


def wrap(text: str, width: int, indent: str = "") -> str:
    """Wrap `text` at spaces; each paragraph's later lines begin with `indent`.

    Long words are not split, nor are a number and its unit or a default in brackets.

    >>> wrap("a force of 0.28 N", 14, "  ")
    'a force of\\n  0.28 N'
    """
    lines = []
    for paragraph in _TOGETHER.sub(lambda found: found[0].replace(" ", _HARD), text).split("\n"):
        words = paragraph.lstrip(" ")
        line, fresh = paragraph[: len(paragraph) - len(words)], True
        for word in words.split(" "):
            if fresh:
                line += word
                fresh = not word
            elif cell_len(line) + 1 + cell_len(word) > width:
                lines.append(line.rstrip())
                line, fresh = indent + word, not word
            else:
                line += f" {word}"
        lines.append(line)
    return "\n".join(lines).replace(_HARD, " ")


def print_text(console: Console, text: str = "", style: str = "", indent: str = "") -> None:
    """Print `text`, wrapped at spaces only: paths, addresses and numbers are not split.

    `style` is one of rich's; `indent` begins the later lines of a paragraph.
    """
    from rich.text import Text

    text = fit_encoding(text, console.encoding)
    if not console.soft_wrap:
        text = wrap(text, console.width, indent)
    console.print(Text(text, style=style), soft_wrap=True)


def print_json(numbers: Any, *, line: bool = False) -> None:
    """Print plain JSON types to standard output, escaped where its encoding requires; `line`: on one line."""
    plain = not (sys.stdout.encoding or "utf-8").lower().startswith("utf")
    text = json.dumps(numbers, indent=None if line else 2, ensure_ascii=plain)
    print(visible(text, lambda letter: json.dumps(letter)[1:-1]), flush=True)


def print_file(text: str) -> None:
    """Print the text of a file to standard output without wrapping, which would change the file."""
    print(fit_encoding(text, sys.stdout.encoding or "utf-8"), end="", flush=True)


def notify(text: str, indent: str = "") -> None:
    """Print a message beside the result on standard error."""
    _print(sys.stderr, text, indent)


def echo(text: str, indent: str = "") -> None:
    """Print the result, or a part of it, on standard output."""
    _print(sys.stdout, text, indent)


def _print(stream: TextIO, text: str, indent: str) -> None:
    text = fit_encoding(text, stream.encoding or "utf-8")
    print(wrap(text, find_width(), indent) if _has_width(stream) else text, file=stream, flush=True)


def _has_width(stream: TextIO) -> bool:
    return stream.isatty() or "COLUMNS" in os.environ


# --------------------------------------------------------------------------------------------------
# Output while coils may be on: a thread of its own writes it.
#
# A terminal does not read after Ctrl-S, nor a pager beyond its first page. Whoever prints then waits: an event loop no
# longer handles a page's Stop, and no other loop sees the end of a duration. Text is therefore queued, whoever prints
# it: a command, a world, a warning of a library.


_MAX_QUEUED_CHARACTERS = 1_000_000  #: beyond that, text is left out
_BLOCKED_INTERVAL_S = 0.01  #: between two attempts to write to what others have set to not block
_LEFT_OUT = "({} characters were left out: nobody read this output)\n"


@contextmanager
def queue_output() -> Iterator[None]:
    """Context in which printing to standard output and error never waits; to be left when the coils are off.

    Leaving it waits until all text is written, or a signal ends the program.
    """
    before = sys.stdout, sys.stderr
    if any(one is None or isinstance(one, _QueuedStream) for one in before):
        yield
        return
    for one in before:
        with suppress(OSError, ValueError):
            one.flush()
    output = _OutputQueue(before[1])
    streams = tuple(cast("TextIO", _QueuedStream(one, output)) for one in before)
    sys.stdout, sys.stderr = streams
    try:
        yield
    finally:
        if sys.stdout is streams[0]:
            sys.stdout = before[0]
        if sys.stderr is streams[1]:
            sys.stderr = before[1]
        output.end()


@final
class _OutputQueue:
    """Thread that writes text in the order in which it was printed."""

    def __init__(self, errors: TextIO) -> None:
        self._errors = errors  #: for the note on what was left out
        self._pieces: SimpleQueue[tuple[TextIO, str] | None] = SimpleQueue()
        self._changing = RLock()  # never held while something is written; handlers of signals print, too
        self._queued = self._left_out = 0  # [characters]
        self._ended = False
        self._thread = Thread(target=self._run, name="haptorb-terminal", daemon=True)
        self._thread.start()

    def put(self, stream: TextIO, text: str) -> None:
        """Enqueue `text`, or leave it out where too much waits already."""
        with self._changing:
            if not self._ended:
                if self._queued and self._queued + len(text) > _MAX_QUEUED_CHARACTERS:
                    self._left_out += len(text)
                else:
                    self._queued += len(text)
                    self._pieces.put((stream, text))
                return
        self._thread.join()  # what was printed before comes first
        _write(stream, text)

    def end(self) -> None:
        """Wait until everything is written; later text is written at once."""
        with self._changing:
            self._ended = True
            self._pieces.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (piece := self._pieces.get()) is not None:
            stream, text = piece
            _write(stream, text)
            with self._changing:
                self._queued -= len(text)
                left_out, self._left_out = self._left_out, 0
            if left_out:
                _write(self._errors, _LEFT_OUT.format(left_out))


@final
class _QueuedStream(TextIOBase):
    """Text stream in place of `stream`: what is written to it is queued."""

    def __init__(self, stream: TextIO, output: _OutputQueue) -> None:
        self._stream, self._output = stream, output

    def write(self, text: str) -> int:
        """Enqueue `text`."""
        self._output.put(self._stream, text)  # safety: output-queued
        return len(text)

    def writable(self) -> bool:
        """It is."""
        return True

    def isatty(self) -> bool:
        """Whether a terminal shows it."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Descriptor of the stream."""
        return self._stream.fileno()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Encoding of the stream."""
        return self._stream.encoding

    @property
    def errors(self) -> str | None:  # type: ignore[override]
        """What happens to characters that the encoding lacks."""
        return self._stream.errors


def _write(stream: TextIO, text: str) -> None:
    """Write `text`; discard it if nobody can read it any more.

    To the descriptor itself, where there is one: the stream's own lock, held by a thread that waits, would stop others
    and the end of the program.
    """
    try:
        descriptor = stream.fileno() if os.name == "posix" else -1
    except (OSError, ValueError, AttributeError):  # a stream of a test or a notebook
        descriptor = -1
    with suppress(OSError, ValueError):
        if descriptor < 0:
            stream.write(text)
            stream.flush()
            return
        left = memoryview(text.encode(stream.encoding or "utf-8", stream.errors or "replace"))
        while left:
            try:
                left = left[os.write(descriptor, left) :]
            except BlockingIOError:
                sleep(_BLOCKED_INTERVAL_S)


# --------------------------------------------------------------------------------------------------
# Tables that fit the width: with wrapped headings and texts, split into pages of columns, or stacked row by row.


_COLUMN_GAP = 2  #: spaces between columns
_TEXT_TABLE_NARROW = 22  #: least width of a wrapped text column


@dataclass(frozen=True)
class Column:
    """Column of a table.

    head  heading
    unit  unit of its numbers; printed in brackets after the heading
    kind  "number": right-aligned, never wrapped; "text": left-aligned, wrapped where space is short; "short":
          left-aligned, never wrapped; "note": text that moves below the row's first cell where space is short; "key":
          left-aligned, never wrapped, repeated on every page
    """

    head: str
    unit: str = ""
    kind: str = "number"

    @property
    def title(self) -> str:
        """Heading and unit.

        >>> Column("peak", "mN").title
        'peak [mN]'
        """
        return f"{self.head} [{self.unit}]".strip() if self.unit else self.head


@dataclass
class TextTable:
    """Columns and rows of a printed table; `title` is above them."""

    columns: tuple[Column, ...]
    title: str = ""
    rows: list[tuple[str, ...]] = field(default_factory=list)
    ends: set[int] = field(default_factory=set)  #: rows followed by a blank line

    def add_row(self, *cells: str) -> None:
        """Append a row with one cell for each column."""
        if len(cells) != len(self.columns):
            raise ValueError(f"a row of this table has {len(self.columns)} cells; got {len(cells)}")
        self.rows.append(cells)

    def end_section(self) -> None:
        """Insert a blank line after the last row."""
        self.ends.add(len(self.rows) - 1)


def print_table(console: Console, table: TextTable) -> None:
    """Print `table` within the console's width and cut no heading, unit or number; empty columns are left out."""
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
    """Split the table into parts that are printed one below the other; None: stacked, each row as names and values."""
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
    return sum(_widths(table)) + _COLUMN_GAP * (len(table.columns) - 1)


def _widest(cell: str) -> int:
    return max(map(cell_len, cell.split("\n")))


def _wrap_heads(table: TextTable, least: int = 0) -> TextTable:
    """Wrap headings to the width of their longest word, their cells or `least`."""
    columns = []
    for n, column in enumerate(table.columns):
        words = map(cell_len, column.title.split())
        room = max([least, *words, *(_widest(row[n]) for row in table.rows)])
        columns.append(Column(wrap(column.title, room), kind=column.kind))
    return TextTable(tuple(columns), rows=table.rows, ends=table.ends)


def _wrap_texts(table: TextTable | None, width: int) -> TextTable | None:
    """Wrap texts into the width that the numbers leave, shared by their lengths; None if that is too small."""
    if table is None:
        return None
    table = _wrap_heads(table)
    widths = _widths(table)
    texts = [n for n, column in enumerate(table.columns) if column.kind in ("text", "note")]
    room = width - _COLUMN_GAP * (len(widths) - 1) - sum(w for n, w in enumerate(widths) if n not in texts)
    for n in sorted(texts, key=lambda n: widths[n]):  # short ones get their full width
        share = room // max(1, sum(widths[k] >= widths[n] for k in texts))
        widths[n] = min(widths[n], share)
        room -= widths[n]
        if widths[n] < min(_TEXT_TABLE_NARROW, _widths(table)[n]):
            return None
    if not texts:
        return None
    rows = [
        tuple(_wrap_cell(cell, widths[n]) if n in texts else cell for n, cell in enumerate(row)) for row in table.rows
    ]
    return TextTable(table.columns, rows=rows, ends=table.ends)


def _wrap_cell(cell: str, width: int) -> str:
    """Wrap a cell; lines with leading spaces keep them."""
    lines = []
    for line in cell.split("\n"):
        margin = " " * (len(line) - len(line.lstrip()))
        body = wrap(line.lstrip(), width - len(margin)).split("\n")
        lines += [margin + part for part in body]
    return "\n".join(lines)


def _fold_notes(table: TextTable) -> TextTable | None:
    """Move notes below the first cell of their row, as `head: text`; None without notes."""
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
    grid = Table(box=box, padding=(0, _COLUMN_GAP - 1, 0, 0), pad_edge=False, show_edge=False, header_style="bold")
    for column in table.columns:
        grid.add_column(Text(column.title), justify="right" if column.kind == "number" else "left", no_wrap=True,
                        vertical="top")  # fmt: skip
    for n, row in enumerate(table.rows):
        grid.add_row(*map(Text, row))
        if n in table.ends and n + 1 < len(table.rows):
            grid.add_row(*("" for _ in row))
    console.print(grid, soft_wrap=False)


def _print_stack(console: Console, table: TextTable) -> None:
    """Print each row separately: its first cell as a title, then the others below it with their headings."""
    last = [""] * len(table.columns)
    for row in table.rows:
        # An omitted key is that of the row above.
        last = [cell or before if c.kind == "key" else cell
                for cell, before, c in zip(row, last, table.columns, strict=True)]  # fmt: skip
        first, *others = zip(table.columns, last, strict=True)
        title = f"{first[0].title} {first[1]}" if first[0].unit else first[1]
        print_text(console, wrap(title, console.width, "  "), "bold")
        for column, cell in others:
            if cell:
                text = f"{column.title}: {cell}" if column.title else cell
                print_text(console, wrap(f"  {text}", console.width, "    "))


# --------------------------------------------------------------------------------------------------
# Lists of names with texts: the facts of a device, the options of a command.


_FACTS_NARROW = 24  #: least width of a text beside its name; below it, the text goes under the name
_MAX_NAME_WIDTH = 26  #: largest width of names with a text beside them
_UNWRAPPED_WIDTH = 100_000  #: line width in a pipe or a file, where nothing is wrapped


def format_facts(facts: Iterable[tuple[str, str]], width: int, margin: str = "") -> list[str]:
    """Format lines of at most `width`: each name, and its text beside or below it.

    >>> format_facts([("coils", "0.6 Ω at 20 °C")], 40)
    ['coils  0.6 Ω at 20 °C']
    """
    pairs = list(facts)
    names = [cell_len(name) for name, _ in pairs if cell_len(name) <= _MAX_NAME_WIDTH]
    column = len(margin) + max(names, default=0) + 2
    if width - column < _FACTS_NARROW:
        column = len(margin) + 2
    lines = []
    for name, text in pairs:
        first = f"{margin}{name}"
        body = wrap(text, width - column).split("\n") if text else []
        if not body or cell_len(first) + 2 > column:
            lines.append(first)
        else:
            lines.append(f"{first}{' ' * (column - cell_len(first))}{body.pop(0)}")
        lines += [f"{' ' * column}{line}" for line in body]
    return lines


def print_facts(console: Console, facts: Iterable[tuple[str, str]]) -> None:
    """Print names and their texts side by side, or under each other where the terminal is narrow.

    Into a pipe or a file: one line each.
    """
    spelled = [(fit_encoding(name, console.encoding), fit_encoding(text, console.encoding)) for name, text in facts]
    for line in format_facts(spelled, _UNWRAPPED_WIDTH if console.soft_wrap else console.width):
        print_text(console, line)


# --------------------------------------------------------------------------------------------------
# Help of commands: no bracket is markup, nothing is truncated, at any width.


_DEVICES = ("device", "devices", "names")  #: arguments that can be a device; `names` are those of `bench`
_MAX_LINE_WIDTH = 100  #: longer lines are hard to read


class CommandLine(typer.Typer):
    """Commands whose help and errors are plain text, never markup."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(
            cls=HelpGroup, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
            rich_markup_mode=None, **settings,
        )  # fmt: skip

    def command(self, name: str | None = None, **settings: Any) -> Any:
        """Register a command, as typer does."""
        return super().command(name, **{"cls": HelpCommand, **settings})


class HelpCommand(TyperCommand):
    """A command with this module's help layout. Its device is an argument; `--device` is still accepted."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse as click does, with the value of `--device` moved to the position of a device; giving an option
        of one value twice is an error: the first value would be lost."""
        if any(one.name in _DEVICES and one.param_type_name == "argument" for one in self.params):
            args = _move_device(args)
        _check_repeated(self, ctx, args)
        words = list(args)
        try:
            return super().parse_args(ctx, args)
        except typer.BadParameter as mistake:
            mistake.message = _explain_number(mistake, words)
            raise

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write usage, text, arguments and options."""
        formatter.write(_compose_help(self, ctx))


class HelpGroup(TyperGroup):
    """A group of commands with this module's help layout."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write usage, text, options and the commands with the first paragraph of each."""
        commands = []
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            if command is not None and not command.hidden:
                commands.append((name, inspect.cleandoc(command.help or "").split("\n\n")[0].replace("\n", " ")))
        formatter.write(_compose_help(self, ctx, commands))


def _move_device(args: list[str]) -> list[str]:
    """Return `args` with the value of `--device VALUE` or `--device=VALUE` as the last argument.

    >>> _move_device(["--device", "pmsm", "--json"]), _move_device(["a.toml", "--device=pmsm"])
    (['--json', 'pmsm'], ['a.toml', 'pmsm'])
    """
    before = args[: args.index("--")] if "--" in args else args
    for place, word in enumerate(before):
        if word == "--device" and place + 1 < len(before):
            return [*args[:place], *args[place + 2 :], args[place + 1]]
        if word.startswith("--device="):
            return [*args[:place], *args[place + 1 :], word.removeprefix("--device=")]
    return args


def _check_repeated(command: Any, ctx: Any, args: list[str]) -> None:
    """Raise a usage error if an option of `command` that takes one value is given several times in `args`."""
    for option, count in Counter(command.make_parser(ctx).parse_args(list(args))[2]).items():
        if count > 1 and option.param_type_name == "option" and not (option.multiple or option.is_flag):
            ctx.fail(f"{option.opts[0]} takes one value; it is given {count} times")


def _explain_number(mistake: Any, words: list[str]) -> str:
    """Return the message of `mistake`; for a number, with the expected type and the value given in `words`."""
    if not mistake.message.startswith("Input should be a valid"):
        return str(mistake.message)
    expected = "a whole number" if "integer" in mistake.message else "a number"
    values = [
        word.removeprefix(f"{option}=") if word.startswith(f"{option}=") else following
        for option in mistake.param.opts
        for word, following in zip(words, [*words[1:], ""], strict=True)
        if word == option or word.startswith(f"{option}=")
    ]
    return f"must be {expected}" + (f"; got {quote(values[-1])}" if values else "")


def _compose_help(command: Any, ctx: Any, commands: list[tuple[str, str]] | None = None) -> str:
    width = min(find_width(), _MAX_LINE_WIDTH)
    usage = " ".join(["Usage:", ctx.command_path, *command.collect_usage_pieces(ctx)])
    text = inspect.cleandoc(command.help or "")
    paragraphs = [" ".join(paragraph.split("\n")) for paragraph in text.split("\n\n") if paragraph]
    lines = [wrap(usage, width, "    "), *(f"\n{wrap(paragraph, width)}" for paragraph in paragraphs)]
    records: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
    for parameter in command.get_params(ctx):
        record = parameter.get_help_record(ctx)
        if record is not None:
            records["Arguments" if parameter.param_type_name == "argument" else "Options"].append(record)
    records["Commands"] = commands or []
    for title, pairs in records.items():
        if pairs:
            lines += [f"\n{title}:", *format_facts(pairs, width, "  ")]
    return "\n".join(fit_encoding(line, sys.stdout.encoding or "utf-8") for line in lines) + "\n"


# --------------------------------------------------------------------------------------------------
# Standard output and error that are missing, or closed by the reader.


def open_output() -> None:
    """Open the null device in place of standard output or error if the program was started without them (`>&-`)."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (until the program ends)


def drop_output() -> None:
    """Discard buffered output after standard output was closed; otherwise Python would write it, and fail, at exit."""
    with suppress(OSError, ValueError):  # a stream without a file
        output, nowhere = sys.stdout.fileno(), os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, output)
        os.close(nowhere)


# --------------------------------------------------------------------------------------------------
# Progress bars and status lines on standard error; nothing is drawn unless it is a terminal.


def make_progress(*, show: bool = True) -> Progress:
    """Create a bar with its task's description and the remaining time; it disappears at the end."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn()
    console = make_console(error=True)  # rich ends a bar with an empty line even if it has drawn none
    return Progress(*columns, console=console, transient=True, disable=not (show and console.is_interactive))


def show_status(text: str) -> Status:
    """Show a line with the running operation until its block ends."""
    from rich.status import Status

    return Status(text, console=make_console(error=True), spinner="line")


# --------------------------------------------------------------------------------------------------
# The message while a command waits for another package's code.


_MESSAGE_DELAY_S = 2.0  #: delay of the message [s]


@contextmanager
def announce_wait(message: str) -> Iterator[None]:
    """Print `message` on standard error if the block takes longer than 2 s, and that Ctrl-C ends it."""
    timer = Timer(_MESSAGE_DELAY_S, notify, [f"{message} for {_MESSAGE_DELAY_S:g} s; still waiting. Ctrl-C ends."])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
