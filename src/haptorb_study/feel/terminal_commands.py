"""Terminal commands of a feel session: one command per line; wrong lines are reported and asked for again."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from select import select

from haptorb.errors import HaptorbError, InputError, quote
from haptorb_study.feel.live_session import LiveSession
from haptorb_study.feel.session import SCORES

__all__ = ["HELP", "execute_line", "read_lines", "wait_for_lines"]


_POLL_INTERVAL_S = 0.2  #: polling interval for the end of the session [s]

HELP = (
    f"Type a score from {SCORES[0]} to {SCORES[1]} and press Enter. Enter alone: next design. a, b: feel A or B. "
    "person CODE: somebody else. hide, show: names and sizes. end: finish."
)


def execute_line(live: LiveSession, line: str) -> None:
    """Execute the command `line`. Raises InputError for invalid commands."""
    line = line.removesuffix("\r")
    person = re.fullmatch("person(?: (.*))?", line, re.IGNORECASE | re.DOTALL)
    if person is not None:  # as typed: another spelling of a code is refused, not corrected
        live.set_person(person[1] or "")
        return
    match line.strip().lower() if line.strip().isalpha() else line:
        case "":
            live.feel_next()
        case "a" | "b" as slot:
            live.feel_slot(slot)
        case "hide" | "show" as setting:
            live.set_blind(setting == "hide")
        case "end":
            live.finish()
        case number if re.fullmatch("0|-?[1-9][0-9]{0,8}", number):
            live.rate(int(number))
        case _:
            raise InputError(f"{quote(line)} is neither a score nor a command; nothing was stored. {HELP}")


def read_lines(live: LiveSession, lines: Iterator[str], notify: Callable[[str], None]) -> None:
    """Execute `lines` until the session or the input ends; a mistake is reported, and the next line read."""
    for line in lines:
        if live.finished:
            return
        try:
            execute_line(live, line)
        except HaptorbError as mistake:
            notify(str(mistake))
        if live.finished:
            return


def wait_for_lines(descriptor: int, ended: Callable[[], bool]) -> Iterator[str]:
    """Lines from `descriptor` until it ends or `ended()`; polled, because a blocking read could not be interrupted."""
    rest = b""
    while not ended():
        if not select([descriptor], [], [], _POLL_INTERVAL_S)[0]:
            continue
        more = os.read(descriptor, 4096)
        if not more:
            if rest:  # the last line of a pipe need not end with a line break
                yield rest.decode("utf-8", "replace")
            return
        *whole, rest = (rest + more).split(b"\n")
        for line in whole:
            yield line.decode("utf-8", "replace")
