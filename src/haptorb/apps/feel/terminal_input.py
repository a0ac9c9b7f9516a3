"""The terminal of a feel session: one line at a time; a line that is wrong is asked for again."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from select import select

from haptorb.apps.feel.live_session import LiveSession
from haptorb.apps.feel.session import SCORES
from haptorb.errors import HaptorbError, InputError, quote

__all__ = ["HELP", "execute_line", "read_lines", "wait_for_lines"]

_LOOK = 0.2  #: between two looks at whether the session has ended [s]

HELP = (
    f"Type a score from {SCORES[0]} to {SCORES[1]} and press Enter. Enter alone: next design. a, b: feel A or B. "
    "person CODE: somebody else. hide, show: names and sizes. end: finish."
)


def execute_line(live: LiveSession, line: str) -> None:
    """Do what `line` says. Raises InputError for what cannot be."""
    word = next(iter(line.split()), "")
    rest = line.strip()[len(word) :].strip()
    command = word.lower()
    if rest and command != "person":
        raise InputError(f"{quote(line.strip())} is neither a score nor a command; nothing was stored. {HELP}")
    match command:
        case "":
            live.feel_next()
        case "a" | "b" as slot:
            live.feel_slot(slot)
        case "person":
            live.set_person(rest)
        case "hide" | "show" as wish:
            live.set_blind(wish == "hide")
        case "end":
            live.finish()
        case number if re.fullmatch("0|-?[1-9][0-9]{0,8}", number):
            live.rate(int(number))
        case _:
            raise InputError(f"{quote(line.strip())} is neither a score nor a command; nothing was stored. {HELP}")


def read_lines(live: LiveSession, lines: Iterator[str], tell: Callable[[str], None]) -> None:
    """Execute `lines` until the session or the input ends; a mistake is reported, and the next line read."""
    for line in lines:
        if live.finished:
            return
        try:
            execute_line(live, line)
        except HaptorbError as mistake:
            tell(str(mistake))
        if live.finished:
            return


def wait_for_lines(descriptor: int, ended: Callable[[], bool]) -> Iterator[str]:
    """The lines that come through `descriptor`, until it ends or `ended()`; a read that blocked could not be ended."""
    rest = b""
    while not ended():
        if not select([descriptor], [], [], _LOOK)[0]:
            continue
        more = os.read(descriptor, 4096)
        if not more:
            if rest:  # the last line of a pipe need not end
                yield rest.decode("utf-8", "replace")
            return
        *whole, rest = (rest + more).split(b"\n")
        for line in whole:
            yield line.decode("utf-8", "replace")
