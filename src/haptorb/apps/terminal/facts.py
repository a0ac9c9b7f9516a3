"""Names and what is to be said of each: the facts of a device, the options of a command."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from rich.cells import cell_len

from haptorb.apps.terminal.console import print_text, wrap
from haptorb.apps.terminal.spelling import fit_encoding

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["format_facts", "print_facts"]

_NARROW = 24  #: least width of what is said; below it, it goes under the name
_LONGEST = 26  #: of the names beside which something is said
_ENDLESS = 100_000  #: lines in a pipe or a file are not wrapped


def format_facts(facts: Iterable[tuple[str, str]], width: int, margin: str = "") -> list[str]:
    """Lines of at most `width`: each name, and beside or under it its text.

    >>> format_facts([("coils", "0.6 Ω at 20 °C")], 40)
    ['coils  0.6 Ω at 20 °C']
    """
    pairs = list(facts)
    names = [cell_len(name) for name, _ in pairs if cell_len(name) <= _LONGEST]
    column = len(margin) + max(names, default=0) + 2
    if width - column < _NARROW:
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
    for line in format_facts(spelled, _ENDLESS if console.soft_wrap else console.width):
        print_text(console, line)
