"""A feel session while its servo runs: what is felt now, by whom, and what they say of it. Page and terminal share it.

All state is here, so that both show the same: `DesignPanel` executes what a page sends, `terminal_input` the terminal's
lines. A rating is on the disk before its method returns.
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
from typing import Any, Protocol, final
from uuid import uuid4

from haptorb.arrays import Array
from haptorb.control.linkage import Gains
from haptorb.devices.base import Device, require
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import HaptorbError, InputError, UnknownName, quote
from haptorb.recording.row import RowLayout
from haptorb_study.feel.designs import Candidate, Candidates
from haptorb_study.feel.session import FELT, SCORES, DesignRating, FeelSession, Trace, check_person, is_felt, trace_rows

__all__ = [
    "HELP",
    "SMALLEST",
    "DesignPanel",
    "FeltServo",
    "LiveFeeling",
    "LiveSession",
    "ScaleLimits",
    "TraceCollector",
    "TrueScale",
    "check_slot",
    "execute_line",
    "keep_feeling",
    "read_lines",
    "wait_for_lines",
    "world_key",
]


# --------------------------------------------------------------------------------------------------
# Which of a servo's rows belong to which trial: by the number of the world in a row.


_LONGEST = 600_000  #: ticks of one feeling that are kept: ten minutes


def world_key(number: int) -> str:
    """The name by which a session's servo knows the world of design `number`, from 0 on: not a world's own name."""
    return f"design {number}"


class FeltServo(Protocol):
    """What a session needs of a servo."""

    @property
    def layout(self) -> RowLayout:
        """Which numbers of a row are what."""
        ...

    def rows(self, cursor: int = 0) -> tuple[int, Array]:
        """All rows (n, width) since `cursor`, and the cursor after them."""
        ...

    def set_world(self, name: str, values: Mapping[str, Any] | None = None) -> None:
        """Returns when the servo took it."""
        ...

    def set_torque_scale(self, scale: float) -> None:
        """All torques of the handle times `scale`."""
        ...


@dataclass
class LiveFeeling:
    """One feeling, from when a design is chosen until the next one is."""

    trace: Trace
    file: str  #: of the trace
    id: str
    person: str
    blind: bool
    scale: float  #: all torques of the handle times this
    score: int | None = None
    felt: bool = False  #: whether something could be felt of it so far, see `trace.is_felt`
    first: Array | None = None  #: its first tick


@final
class TraceCollector:
    """Feelings by the number of their world in the servo's rows; every new world is a feeling."""

    def __init__(self) -> None:
        self._feelings: dict[int, LiveFeeling] = {}
        self._world = 0

    def begin(self, feeling: LiveFeeling, *, served: bool = False) -> None:
        """From now on `feeling`; `served`: a servo has just been given its world."""
        self._world += served
        self._feelings[self._world] = feeling

    def collect(self, layout: RowLayout, rows: Array) -> list[LiveFeeling]:
        """Take `rows` (n, width) into the traces; returns the feelings that ended."""
        worlds = rows[:, layout["world"].start]
        for number, feeling in self._feelings.items():
            room = max(_LONGEST - len(feeling.trace), 0)
            found = trace_rows(layout, rows[worlds == number])
            feeling.trace.extend(found[:room])
            if len(found) and not feeling.felt:
                feeling.first = found[0] if feeling.first is None else feeling.first
                feeling.felt = is_felt(found, feeling.first)
        ended = [number for number in self._feelings if len(worlds) and number < worlds[-1]]
        return [self._feelings.pop(number) for number in ended]

    def end(self) -> list[LiveFeeling]:
        """What was not ended by another feeling."""
        left, self._feelings = list(self._feelings.values()), {}
        return left


def keep_feeling(session: FeelSession, feeling: LiveFeeling, *, gently: bool) -> None:
    """Write the trace of `feeling`, unless it is empty."""
    if len(feeling.trace):
        session.keep(
            feeling.trace, name=feeling.file, person=feeling.person, feeling=feeling.id, blind=feeling.blind,
            scale=feeling.scale, gently=gently,
        )  # fmt: skip


# --------------------------------------------------------------------------------------------------
# What a force at the part is in the hand: the motor's handle, its gains and the torque scale between them.


SMALLEST = 0.05  #: of gains that a session offers


@dataclass(frozen=True)
class ScaleLimits:
    """How strong the designs of a session may be felt: gain times what the design file says.

    largest         gain
    reason          why not more, in words
    hand_per_part   force in the hand per force on the part at gain 1
    """

    largest: float = 1.0
    reason: str = "the stability check is still running"
    hand_per_part: float = 0.2


@dataclass(frozen=True)
class TrueScale:
    """The way from a force on the part along X' to the hand, in translation.

    >>> from haptorb.control.linkage import MOTOR_GAINS
    >>> from haptorb.devices.loader import load
    >>> scale = TrueScale.of(load("pmsm"), MOTOR_GAINS)
    >>> scale.hand_per_part, scale.whole
    (0.2, 5.0)
    """

    lever: float  #: torque on the handle per force on the part [m]
    arm: float  #: from the motor's centre to the hand [m]
    limit: float  #: largest torque of the device [N·m]

    @classmethod
    def of(cls, device: Device, gains: Gains) -> TrueScale:
        """For `device` with `gains`. Raises InputError for a device without a handle."""
        rotor = require(device, SphericalMotor, "feeling designs").rotor
        return cls(gains.torques[0][1], rotor.handle_length, device.limits.torque)

    @property
    def hand_per_part(self) -> float:
        """Force in the hand per force on the part: 0.2 on the default handle with the default gains."""
        return round(self.lever / self.arm, 12)

    @property
    def whole(self) -> float:
        """The torque scale at which one newton at the part is one newton in the hand."""
        return round(self.arm / self.lever, 12) if self.lever else float("inf")

    @property
    def sentence(self) -> str:
        """The scale in words, without a full stop."""
        return (
            f"1 N at the part is {self.hand_per_part:.2g} N in the hand on the {1e3 * self.arm:.0f} mm handle at gain "
            f"1; gain {self.whole:.3g} is 1 : 1"
        )

    @property
    def unknown_limits(self) -> ScaleLimits:
        """The limits until they are computed."""
        return ScaleLimits(hand_per_part=self.hand_per_part)

    def find_saturation(self, peak: float) -> float:
        """The torque scale at which a force of `peak` [N] on the part reaches the device's torque limit."""
        return self.limit / (self.lever * peak) if peak * self.lever else float("inf")


_SLOTS = ("a", "b")


@final
class LiveSession:
    """One source of truth for page and terminal; every method may be called from any thread.

    session   where ratings and traces are kept
    designs   that can be felt, in the file's order
    person    code of who feels them; "" for none
    blind     whether names, sizes and pictures are hidden
    limits    how strong the designs may be felt
    seed      of the random order; None: another one each time
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
        self._servo: FeltServo | None = None
        self._cursor = 0
        self._felt = TraceCollector()
        self._blind = blind
        self._scale = 1.0
        self.person = check_person(person, session.people())
        self.finished = False
        self.version = 0  #: another number after every change
        self.notify: Callable[[str], None] = lambda text: None  #: is called with what was rated or chosen, in words
        order = self._order
        self._pair = {"a": order[0], "b": order[1 % len(order)]}
        self._now = self._start(self._find_next(None))
        self._felt.begin(self._now)

    # what there is

    @property
    def candidates(self) -> Candidates:
        """The file that the designs are from."""
        return self._session.candidates

    @property
    def current(self) -> Candidate:
        """The design that is felt."""
        return self._now.trace.design

    @property
    def hidden(self) -> bool:
        """Whether the designs are hidden from the person."""
        return self._blind

    @property
    def label(self) -> str:
        """What the present design is called before the person: its title, or a number."""
        return self._label(self.current)

    @property
    def _order(self) -> list[Candidate]:
        """The designs as they are numbered for this person: shuffled, so that numbers and turns tell nothing."""
        if self.person not in self._orders:
            self._orders[self.person] = self._random.sample(self.designs, len(self.designs))
        return self._orders[self.person]

    def describe(self) -> dict[str, Any]:
        """Everything that the page shows, as plain JSON types; nothing in it reveals a hidden design."""
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
                "gain": {
                    "now": self._scale,
                    "low": SMALLEST,
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

    # what a person does

    def rate(self, score: object, feeling: str = "") -> None:
        """Keep what the person says of the design that is felt now, again if they change their mind.

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
            self._tell(f"{self.label}: rated {score}" + (f" by {self.person}" if self.person else ""))

    def feel_next(self) -> None:
        """Continue with one of the designs that this person rated least often, in random order."""
        with self._lock:
            self.feel(self._find_next(self.current))

    def _find_next(self, after: Candidate | None) -> Candidate:
        order, rated = self._order, Counter(one.design for one in self._list_ratings())
        start = 0 if after is None else 1 + order.index(after)
        turns = [order[(start + k) % len(order)] for k in range(len(order))]
        return min(turns, key=lambda design: rated[design.name])  # the first of those

    def feel(self, design: Candidate) -> None:
        """Render `design` from the next tick on; a new feeling begins, also of the same design."""
        with self._lock:
            self._check_running()
            if self._servo is not None:
                self._servo.set_world(world_key(self.designs.index(design)))
            self._now = self._start(design)
            self._felt.begin(self._now, served=self._servo is not None)
            self._tell(f"now: {self.label}")

    def feel_slot(self, slot: str) -> None:
        """Render what stands in slot "a" or "b"."""
        self.feel(self._pair[check_slot(slot)])

    def set_pair(self, slot: str, design: Candidate) -> None:
        """Put `design` into slot "a" or "b"."""
        with self._lock:
            self._pair[slot] = design
            self._tell(f"{slot.upper()}: {self._label(design)}")

    def set_person(self, code: str) -> None:
        """Another person feels from now on, with separate ratings and order."""
        with self._lock:
            self._check_running()
            code = check_person(code, self._session.people())
            if code == self.person:
                return
            self.person = code
            self._tell(f"person: {code or 'no code'}")
            order = self._order
            self._pair = {"a": order[0], "b": order[1 % len(order)]}
            self.feel(self._find_next(None))

    def set_blind(self, blind: bool) -> None:
        """Hide the designs from now on, or show them. Hiding begins with another order and design: the present ones
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
            self._tell("designs hidden" if blind else f"designs shown; now: {self.label}")

    def set_scale(self, scale: object) -> None:
        """All torques of the handle times `scale` from now on, as far as stability and the device allow; a new feeling
        begins."""
        with self._lock:
            self._check_running()
            largest = self.limits.largest
            if isinstance(scale, bool) or not isinstance(scale, int | float) or not SMALLEST <= scale <= largest:
                wanted = f"between {SMALLEST:g} and {largest:.3g} ({self.limits.reason})"
                raise InputError(f"the gain must lie {wanted}; got {quote(scale)}")
            if self._servo is not None:
                self._servo.set_torque_scale(float(scale))
            self._scale = float(scale)
            self.feel(self.current)
            self._tell(f"gain {scale:g}")

    def set_limits(self, limits: ScaleLimits) -> None:
        """What is known by now of how strong the designs may be felt."""
        with self._lock:
            self.limits = limits
            self._tell(f"gain: at most {limits.largest:.3g}: {limits.reason}")

    def finish(self) -> None:
        """The session ends; its servo is to be closed by who opened it."""
        with self._lock:
            self.finished = True
            self._tell("finished")

    # what the servo does

    def join(self, servo: FeltServo) -> None:
        """From now on designs are rendered by `servo`, which renders `current` and knows all by their `world_key`."""
        self._servo = servo

    def collect(self) -> None:
        """Take the servo's new rows into the traces; to be called several times a second."""
        with self._lock:
            if self._servo is None:
                return
            self._cursor, rows = self._servo.rows(self._cursor)
            before = self._now.felt
            done = self._felt.collect(self._servo.layout, rows)
            self.version += self._now.felt and not before
        for feeling in done:
            keep_feeling(self._session, feeling, gently=True)

    def close(self) -> None:
        """Keep the traces of what was felt last; after the servo has ended."""
        with self._lock:
            left = self._felt.end()
        for feeling in left:
            keep_feeling(self._session, feeling, gently=False)

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

    def _tell(self, text: str) -> None:
        self.version += 1
        self.notify(text)


def check_slot(slot: object) -> str:
    """`slot` itself, "a" or "b"; UnknownName for anything else."""
    if slot not in _SLOTS:
        raise UnknownName("slot", str(slot)[:20], _SLOTS)
    return str(slot)


# --------------------------------------------------------------------------------------------------
# The terminal of a feel session: one line at a time; a line that is wrong is asked for again.


_LOOK = 0.2  #: between two looks at whether the session has ended [s]

HELP = (
    f"Type a score from {SCORES[0]} to {SCORES[1]} and press Enter. Enter alone: next design. a, b: feel A or B. "
    "person CODE: somebody else. hide, show: names and sizes. end: finish."
)


def execute_line(live: LiveSession, line: str) -> None:
    """Do what `line` says. Raises InputError for what cannot be."""
    line = line.removesuffix("\r")
    person = re.fullmatch("person(?: (.*))?", line, re.IGNORECASE | re.DOTALL)
    if person is not None:  # as it was typed: another spelling of a code is refused, not changed
        live.set_person(person[1] or "")
        return
    match line.strip().lower() if line.strip().isalpha() else line:
        case "":
            live.feel_next()
        case "a" | "b" as slot:
            live.feel_slot(slot)
        case "hide" | "show" as wish:
            live.set_blind(wish == "hide")
        case "end":
            live.finish()
        case number if re.fullmatch("0|-?[1-9][0-9]{0,8}", number):
            live.rate(int(number))
        case _:
            raise InputError(f"{quote(line)} is neither a score nor a command; nothing was stored. {HELP}")


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


# --------------------------------------------------------------------------------------------------
# The panel of a feel session in the console's page: what it shows, and what a page may ask for.


@final
class DesignPanel:
    """`live` as the console takes it (`console.designs.DesignSession`)."""

    def __init__(self, live: LiveSession) -> None:
        self._live = live

    @property
    def version(self) -> int:
        """Another number after every change."""
        return self._live.version

    @property
    def hidden(self) -> bool:
        """Whether name, values and picture of the design are hidden from every page."""
        return self._live.hidden

    def describe(self) -> dict[str, Any]:
        """Everything that the page shows, as plain JSON types."""
        return self._live.describe()

    def execute(self, command: Mapping[str, Any]) -> None:
        """What a page asks for: {"act": NAME, ...}. Raises InputError for what cannot be."""
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
