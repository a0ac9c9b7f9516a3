"""Consoles, and prose and JSON on them."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
from typing import TYPE_CHECKING, Any, TextIO

from rich.cells import cell_len

from haptorb.apps.terminal.spelling import fit_encoding

if TYPE_CHECKING:  # which costs a program that prints two lines 50 ms
    from rich.console import Console

__all__ = ["find_width", "make_console", "print_file", "print_json", "print_text", "say", "tell", "wrap"]

#: what JSON does not escape by itself and a terminal, or a reader, would be misled by
_HIDDEN = re.compile("[\x7f-\x9f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u2069\ufeff\ud800-\udfff]")
_HARD = "\N{NO-BREAK SPACE}"
_TOGETHER = re.compile(
    r"\[(?:default|required)[^]]*\]"
    r"|`haptorb [^`\n]*`"  # a command is copied in one piece
    r"|[\d.] (?:%|×|±|°C?|1/s|[nµmkMG]?(?:N|m|s|A|V|W|Ω|Hz|T|g|K|J|B)[²³]?(?:[·/][\w·/²]+)?)(?![\w])"
)


def make_console(*, error: bool = False) -> Console:
    """A console on standard output, or standard error.

    Prose is wrapped at the width of a terminal, or at COLUMNS; into a pipe or a file it goes as it is.
    """
    from rich.console import Console

    wraps = _has_width(sys.stderr if error else sys.stdout)
    return Console(stderr=error, markup=False, emoji=False, highlight=False, soft_wrap=not wraps)


def find_width() -> int:
    """Columns of the terminal, or COLUMNS; 80 where there is neither."""
    return shutil.get_terminal_size().columns


def wrap(text: str, width: int, indent: str = "") -> str:
    """`text` wrapped at spaces; each paragraph's later lines begin with `indent`.

    Longer words stay whole, and so do a number with its unit and a default in brackets.

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
    """Print `text`, wrapped at spaces only: paths, addresses and numbers stay whole.

    `style` is one of rich's; `indent` begins the later lines of a paragraph.
    """
    from rich.text import Text

    text = fit_encoding(text, console.encoding)
    if not console.soft_wrap:
        text = wrap(text, console.width, indent)
    console.print(Text(text, style=style), soft_wrap=True)


def print_json(numbers: Any, *, line: bool = False) -> None:
    """Print plain JSON types to standard output, escaped where it could not carry them; `line`: on one line."""
    plain = not (sys.stdout.encoding or "utf-8").lower().startswith("utf")
    text = json.dumps(numbers, indent=None if line else 2, ensure_ascii=plain)
    print(_HIDDEN.sub(lambda found: json.dumps(found[0])[1:-1], text), flush=True)


def print_file(text: str) -> None:
    """Print the text of a file to standard output, line by line as it is: a line that is wrapped is another file."""
    print(fit_encoding(text, sys.stdout.encoding or "utf-8"), end="", flush=True)


def say(text: str, indent: str = "") -> None:
    """Tell people something beside the result, on standard error."""
    _print(sys.stderr, text, indent)


def tell(text: str, indent: str = "") -> None:
    """Tell the result, or a part of it, on standard output."""
    _print(sys.stdout, text, indent)


def _print(stream: TextIO, text: str, indent: str) -> None:
    text = fit_encoding(text, stream.encoding or "utf-8")
    print(wrap(text, find_width(), indent) if _has_width(stream) else text, file=stream, flush=True)


def _has_width(stream: TextIO) -> bool:
    return stream.isatty() or "COLUMNS" in os.environ
