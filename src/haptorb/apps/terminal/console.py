"""Consoles, and prose and JSON on them."""

from __future__ import annotations

import json
import os
import re
import sys
from typing import Any

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from haptorb.apps.terminal.spelling import fit_encoding

__all__ = ["make_console", "print_json", "print_text", "say", "tell", "wrap"]

_HARD = "\N{NO-BREAK SPACE}"
_TOGETHER = re.compile(
    r"\[(?:default|required)[^]]*\]|[\d.] (?:%|×|±|°C?|[nµmkMG]?(?:N|m|s|A|V|W|Ω|Hz|T|g|K|J|B)(?:[·/][\w·/²]+)?)(?![\w])"
)


def make_console(*, error: bool = False) -> Console:
    """A console on standard output, or standard error.

    Prose is wrapped at the width of a terminal, or at COLUMNS; into a pipe or a file it goes as it is.
    """
    stream = sys.stderr if error else sys.stdout
    wraps = stream.isatty() or "COLUMNS" in os.environ
    return Console(stderr=error, markup=False, emoji=False, highlight=False, soft_wrap=not wraps)


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
    text = fit_encoding(text, console.encoding)
    if not console.soft_wrap:
        text = wrap(text, console.width, indent)
    console.print(Text(text, style=style), soft_wrap=True)


def print_json(numbers: Any) -> None:
    """Print plain JSON types to standard output; escaped where it could not carry them."""
    plain = not (sys.stdout.encoding or "utf-8").lower().startswith("utf")
    print(json.dumps(numbers, indent=2, ensure_ascii=plain), flush=True)


def say(text: str) -> None:
    """Tell people something beside the result, on standard error."""
    print_text(make_console(error=True), text)


def tell(text: str, indent: str = "") -> None:
    """Tell the result, or a part of it, on standard output."""
    print_text(make_console(), text, indent=indent)
