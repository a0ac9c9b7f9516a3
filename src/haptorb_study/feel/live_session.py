"""A feel session while its servo runs: current design, person, ratings. Shared by page and terminal.

`FeelPanel` executes the commands of a page, `execute_line` those of the terminal. A rating is durable when its
method returns.
"""

from __future__ import annotations

import os
import random
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from select import select
from threading import RLock
from typing import TYPE_CHECKING, Any, final
from uuid import uuid4

from haptorb.arrays import Array
from haptorb.errors import HaptorbError, InputError, UnknownName, quote
from haptorb.recording.row import RowLayout
from haptorb_study.feel.designs import Candidate, Candidates
from haptorb_study.feel.session import SCORES, DesignRating, FeelSession, check_person
from haptorb_study.feel.torque_scale import MIN_SCALE, ScaleLimits
from haptorb_study.feel.trace import FELT, Trace, is_felt, trace_rows

if TYPE_CHECKING:
    from haptorb.runtime.servo import Servo

__all__ = [
    "HELP",
    "FeelPanel",
    "LiveFeeling",
    "LiveSession",
    "TraceCollector",
    "check_slot",
    "execute_line",
    "read_lines",
    "store_feeling",
    "wait_for_lines",
    "world_key",
]


# --------------------------------------------------------------------------------------------------
# Presentations: assignment of the servo's rows to them, by the world's number in a row.


_MAX_TRACE_TICKS = 600_000  #: ticks recorded of one presentation: ten minutes


def world_key(number: int) -> str:
    """Name of the world of design `number` (from 0) in the session's servo; never the name of a catalogue world."""
    return f"design {number}"


@dataclass
class LiveFeeling:
    """One presentation of a design: from its selection to the next."""

    trace: Trace
    file: str  #: of the trace
    id: str
    person: str
    blind: bool
    scale: float  #: factor of all torques of the handle
    score: int | None = None
    felt: bool = False  #: whether it exceeded the perception limits so far, see `trace.is_felt`
    first: Array | None = None  #: its first tick


@final
class TraceCollector:
    """Collects the presentations by the world's number in the servo's rows; every new world is a presentation."""

    def __init__(self) -> None:
        self._feelings: dict[int, LiveFeeling] = {}
        self._world = 0

    def begin(self, feeling: LiveFeeling, *, served: bool = False) -> None:
        """Start `feeling`; `served`: a servo has just been given its world."""
        self._world += served
        self._feelings[self._world] = feeling

    def collect(self, layout: RowLayout, rows: Array) -> list[LiveFeeling]:
        """Append `rows` (n, width) to the traces; returns the presentations that ended."""
        worlds = rows[:, layout["world"].start]
        for number, feeling in self._feelings.items():
            room = max(_MAX_TRACE_TICKS - len(feeling.trace), 0)
            found = trace_rows(layout, rows[worlds == number])
            feeling.trace.extend(found[:room])
            if len(found) and not feeling.felt:
                feeling.first = found[0] if feeling.first is None else feeling.first
                feeling.felt = is_felt(found, feeling.first)
        ended = [number for number in self._feelings if len(worlds) and number < worlds[-1]]
        return [self._feelings.pop(number) for number in ended]

    def end(self) -> list[LiveFeeling]:
        """End the presentations that are still open."""
        left, self._feelings = list(self._feelings.values()), {}
        return left


def store_feeling(session: FeelSession, feeling: LiveFeeling, *, gently: bool) -> None:
    """Write the trace of `feeling`, unless it is empty."""
    if len(feeling.trace):
        session.store_trace(
            feeling.trace, name=feeling.file, person=feeling.person, feeling=feeling.id, blind=feeling.blind,
            scale=feeling.scale, gently=gently,
        )  # fmt: skip


# --------------------------------------------------------------------------------------------------
# State of the session.


_SLOTS = ("a", "b")


@final
class LiveSession:
    """State of a feel session, shared by page and terminal; every method may be called from any thread.

    session   storage of ratings and traces
    designs   in the file's order
    person    code of the person who rates; "" for none
    blind     whether names, sizes and pictures are hidden
    limits    of the torque scale
    seed      of the random order; None: random
    """

    def __init__(
        self,
        session: FeelSession,
        designs: list[Candidate],
        *,
        person: str = "",
        blind: bool = False,
        limits: ScaleLimits | None = None,
        seed: int | None = None,
    ) -> None:
        self._session, self.designs = session, tuple(designs)
        self.limits = limits or ScaleLimits()
        self._random = random.Random(seed)
        self._lock = RLock()
        self._orders: dict[str, list[Candidate]] = {}  # by person
        self._servo: Servo | None = None
        self._cursor = 0
        self._felt = TraceCollector()
        self._blind = blind
        self._scale = 1.0
        self.person = check_person(person, session.people())
        self.finished = False
        self.version = 0  #: changes with every state change
        self.notify: Callable[[str], None] = lambda text: None  #: called when a design is rated or chosen
        order = self._order
        self._pair = {"a": order[0], "b": order[1 % len(order)]}
        self._now = self._start(self._find_next(None))
        self._felt.begin(self._now)

    # queries

    @property
    def candidates(self) -> Candidates:
        """File of the designs."""
        return self._session.candidates

    @property
    def current(self) -> Candidate:
        """The design being rendered."""
        return self._now.trace.design

    @property
    def hidden(self) -> bool:
        """Whether the session is blind: designs are hidden from the person."""
        return self._blind

    @property
    def label(self) -> str:
        """Label of the current design for the person: its title, or in a blind session a number."""
        return self._label(self.current)

    @property
    def _order(self) -> list[Candidate]:
        """Order of the designs for this person: shuffled, so that numbers and positions carry no information."""
        if self.person not in self._orders:
            self._orders[self.person] = self._random.sample(self.designs, len(self.designs))
        return self._orders[self.person]

    def describe(self) -> dict[str, Any]:
        """State for the page as plain JSON types; in a blind session it does not identify designs."""
        with self._lock:
            order, last = self._order, {one.design: one.score for one in self._list_ratings()}
            return {
                "title": self._session.candidates.title,
                "person": self.person,
                "people": list(self._session.people()),
                "hidden": self._blind,
                "scale": list(SCORES),
                "number": 1 + order.index(self.current),
                "label": self.label,
                "feeling": self._now.id,
                "score": self._now.score,
                "felt": self._now.felt or self._servo is None,
                **{slot: 1 + order.index(design) for slot, design in self._pair.items()},
                "designs": [
                    {
                        "number": number,
                        "label": self._label(design),
                        "score": last.get(design.name),
                        "remarks": [] if self._blind else list(design.remarks),
                    }
                    for number, design in enumerate(order, 1)
                ],
                "finished": self.finished,
                "torque_scale": {
                    "now": self._scale,
                    "low": MIN_SCALE,
                    "high": self.limits.largest,
                    "reason": self.limits.reason,
                    "hand": self.limits.hand_per_part * self._scale,
                },
            }

    def _list_ratings(self) -> list[DesignRating]:
        """Those of this person of designs as they are now; while designs are hidden, those from when they were, too:
        another score would tell which is which."""
        now = {design.name: design.digest for design in self.designs}
        given = (one for one in self._session.ratings() if one.person == self.person)
        return [one for one in given if now.get(one.design) == one.digest and (one.blind or not self._blind)]

    def _label(self, design: Candidate) -> str:
        return f"Design {1 + self._order.index(design)}" if self._blind else design.title

    # commands

    def rate(self, score: object, feeling: str = "") -> None:
        """Store the person's rating of the current design; a second rating of a presentation replaces the first.

        `feeling` names what they were shown: refused if another design is felt by then.
        """
        with self._lock:
            self._check_running()
            now = self._now
            if feeling and feeling != now.id:
                raise InputError("another design was chosen before this score arrived: not stored. Rate again")
            if isinstance(score, bool) or not isinstance(score, int) or not SCORES[0] <= score <= SCORES[1]:
                low, high = SCORES
                raise InputError(f"a score is a whole number from {low} to {high}; got {quote(score)}. Rate again")
            self.collect()
            if self._servo is not None and not now.felt:
                raise InputError(f"{self.label} has not been felt yet ({FELT}): not stored. Move the handle, then rate")
            self._session.rate(
                now.trace.design.name, score, person=now.person, trace=now.file, feeling=now.id, blind=now.blind
            )
            now.score = score
            self._notify(f"{self.label}: rated {score}" + (f" by {self.person}" if self.person else ""))

    def feel_next(self) -> None:
        """Present one of the designs that this person rated least often, in random order."""
        with self._lock:
            self.feel(self._find_next(self.current))

    def _find_next(self, after: Candidate | None) -> Candidate:
        order, rated = self._order, Counter(one.design for one in self._list_ratings())
        start = 0 if after is None else 1 + order.index(after)
        turns = [order[(start + k) % len(order)] for k in range(len(order))]
        return min(turns, key=lambda design: rated[design.name])  # the first of them

    def feel(self, design: Candidate) -> None:
        """Render `design` from the next tick on; starts a new presentation, also of the same design."""
        with self._lock:
            self._check_running()
            if self._servo is not None:
                self._servo.set_world(world_key(self.designs.index(design)))
            self._now = self._start(design)
            self._felt.begin(self._now, served=self._servo is not None)
            self._notify(f"now: {self.label}")

    def feel_slot(self, slot: str) -> None:
        """Render the design in slot "a" or "b"."""
        self.feel(self._pair[check_slot(slot)])

    def set_pair(self, slot: str, design: Candidate) -> None:
        """Assign `design` to slot "a" or "b"."""
        with self._lock:
            self._pair[slot] = design
            self._notify(f"{slot.upper()}: {self._label(design)}")

    def set_person(self, code: str) -> None:
        """Set the person who rates; each has separate ratings and order."""
        with self._lock:
            self._check_running()
            code = check_person(code, self._session.people())
            if code == self.person:
                return
            self.person = code
            self._notify(f"person: {code or 'no code'}")
            order = self._order
            self._pair = {"a": order[0], "b": order[1 % len(order)]}
            self.feel(self._find_next(None))

    def set_blind(self, blind: bool) -> None:
        """Hide the designs, or show them again. Hiding starts with a new order and another design: the present ones
        are known."""
        with self._lock:
            self._check_running()
            if blind == self._blind:
                return
            self._blind = blind
            if blind:
                self._orders.pop(self.person)
                order = self._order
                self._pair = {"a": order[0], "b": order[1 % len(order)]}
                self.feel(self._find_next(None))
            else:
                self._now.blind = False
            self._notify("designs hidden" if blind else f"designs shown; now: {self.label}")

    def set_scale(self, scale: object) -> None:
        """All torques of the handle times `scale` from now on, as far as stability and the device allow; a new feeling
        begins."""
        with self._lock:
            self._check_running()
            largest = self.limits.largest
            if isinstance(scale, bool) or not isinstance(scale, int | float) or not MIN_SCALE <= scale <= largest:
                wanted = f"between {MIN_SCALE:g} and {largest:.3g} ({self.limits.reason})"
                raise InputError(f"the torque scale must lie {wanted}; got {quote(scale)}")
            if self._servo is not None:
                self._servo.set_torque_scale(float(scale))
            self._scale = float(scale)
            self.feel(self.current)
            self._notify(f"torque scale {scale:g}")

    def set_limits(self, limits: ScaleLimits) -> None:
        """Set the limits of the torque scale, once computed."""
        with self._lock:
            self.limits = limits
            self._notify(f"torque scale: at most {limits.largest:.3g}: {limits.reason}")

    def finish(self) -> None:
        """Finish the session; its servo is closed by whoever opened it."""
        with self._lock:
            self.finished = True
            self._notify("finished")

    # servo

    def attach(self, servo: Servo) -> None:
        """Attach `servo`, which renders `current` and has all designs by their `world_key`."""
        self._servo = servo

    def collect(self) -> None:
        """Append the servo's new rows to the traces; to be called several times per second."""
        with self._lock:
            if self._servo is None:
                return
            self._cursor, rows = self._servo.rows(self._cursor)
            before = self._now.felt
            done = self._felt.collect(self._servo.layout, rows)
            self.version += self._now.felt and not before
        for feeling in done:
            store_feeling(self._session, feeling, gently=True)

    def close(self) -> None:
        """Write the traces of the last presentation, after the servo has ended."""
        with self._lock:
            left = self._felt.end()
        for feeling in left:
            store_feeling(self._session, feeling, gently=False)

    def _start(self, design: Candidate) -> LiveFeeling:
        file = self._session.reserve(design.name)
        return LiveFeeling(Trace(design), file, uuid4().hex[:12], self.person, self._blind, self._scale)

    def design_of(self, number: object) -> Candidate:
        """The design with this number in the person's order; UnknownName if there is none."""
        order = self._order
        if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number <= len(order):
            raise UnknownName("number of a design", str(number)[:20], [str(1 + k) for k in range(len(order))])
        return order[number - 1]

    def _check_running(self) -> None:
        if self.finished:
            raise InputError("this feel session has ended; its report is being written")

    def _notify(self, text: str) -> None:
        self.version += 1
        self.notify(text)


def check_slot(slot: object) -> str:
    """Validate `slot`, "a" or "b"; UnknownName for anything else."""
    if slot not in _SLOTS:
        raise UnknownName("slot", str(slot)[:20], _SLOTS)
    return str(slot)


# --------------------------------------------------------------------------------------------------
# Panel of the session in the console page: its state and its commands.


@final
class FeelPanel:
    """Adapter of `live` to the console (`console_hub.DesignSession`)."""

    def __init__(self, live: LiveSession) -> None:
        self._live = live

    @property
    def version(self) -> int:
        """Changes with every state change."""
        return self._live.version

    @property
    def hidden(self) -> bool:
        """Whether name, values and picture of the design are hidden from every page."""
        return self._live.hidden

    def describe(self) -> dict[str, Any]:
        """State for the page as plain JSON types."""
        return self._live.describe()

    def execute(self, command: Mapping[str, Any]) -> None:
        """Execute a page's command: {"act": NAME, ...}. Raises InputError for invalid commands."""
        live = self._live
        match command.get("act"):
            case "rate":
                live.rate(command.get("score"), _text(command, "feeling"))
            case "next":
                live.feel_next()
            case "feel":
                live.feel(live.design_of(command.get("number")))
            case "slot":
                live.feel_slot(check_slot(command.get("slot")))
            case "pair":
                live.set_pair(check_slot(command.get("slot")), live.design_of(command.get("number")))
            case "person":
                live.set_person(_text(command, "person"))
            case "hide":
                live.set_blind(command.get("hide") is True)
            case "scale":
                live.set_scale(command.get("scale"))
            case "finish":
                live.finish()
            case other:
                known = "rate, next, feel, slot, pair, person, hide, scale, finish"
                raise InputError(f"unknown act {quote(other)} of a feel session (known: {known})")


def _text(command: Mapping[str, Any], name: str) -> str:
    value = command.get(name, "")
    if not isinstance(value, str):
        raise InputError(f"{name} must be a text; got {quote(value)}")
    return value


# --------------------------------------------------------------------------------------------------
# Terminal commands: one command per line; wrong lines are reported and asked for again.


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
