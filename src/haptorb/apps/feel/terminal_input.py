"""The terminal of a feel session: one line at a time; a line that is wrong is asked for again."""

from __future__ import annotations

from collections.abc import Callable

from haptorb.apps.feel.live_session import LiveSession
from haptorb.apps.feel.session import SCORES
from haptorb.errors import HaptorbError, InputError

__all__ = ["HELP", "execute_line", "read_lines"]

HELP = (
    f"Type a score from {SCORES[0]} to {SCORES[1]} and press Enter. Enter alone: next design. a, b: feel A or B. "
    "person CODE: somebody else. hide, show: names and sizes. end: finish."
)


def execute_line(live: LiveSession, line: str) -> None:
    """Do what `line` says. Raises InputError for what cannot be."""
    word, _, rest = line.strip().partition(" ")
    match word.lower():
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
        case number if number.isascii() and number.lstrip("-").isdecimal():
            live.rate(int(number[:9]))
        case _:
            raise InputError(f"'{line.strip()[:40]}' is neither a score nor a command. {HELP}")


def read_lines(live: LiveSession, read: Callable[[], str], tell: Callable[[str], None]) -> None:
    """Execute lines until the session or the input ends; a mistake is told, and the next line read."""
    while not live.finished:
        try:
            execute_line(live, read())
        except EOFError:
            return
        except HaptorbError as mistake:
            tell(str(mistake))
