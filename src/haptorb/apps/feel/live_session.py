"""A feel session while its servo runs: what is felt now, by whom, and what they say of it. Page and terminal share it.

All state is here, so that both show the same: the page sends commands (`execute`) and shows `describe`, the terminal
calls the methods. A rating is on the disk before its method returns.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from threading import RLock
from typing import Any, Protocol, final
from uuid import uuid4

from haptorb.apps.feel.candidates import Candidate
from haptorb.apps.feel.records import DesignRating
from haptorb.apps.feel.session import SCORES, FeelSession, check_person
from haptorb.apps.feel.trace import Trace, trace_rows
from haptorb.errors import InputError, UnknownName, quote
from haptorb.numerics.arrays import Array
from haptorb.runtime.row import RowLayout

__all__ = ["FeltServo", "LiveSession", "world_key"]

_LONGEST = 600_000  #: ticks of one feeling that are kept: ten minutes
_SLOTS = ("a", "b")


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


@dataclass
class _Now:
    """One feeling, from when a design is chosen until the next one is."""

    trace: Trace
    file: str  #: of the trace
    id: str
    person: str
    blind: bool
    score: int | None = None


@final
class LiveSession:
    """One source of truth for page and terminal; every method may be called from any thread.

    session   where ratings and traces are kept
    designs   that can be felt, in the file's order
    person    code of who feels them; "" for none
    blind     whether names, sizes and pictures are hidden
    facts     more that the page shows, such as the true scale
    seed      of the random order; None: another one each time
    """

    def __init__(
        self,
        session: FeelSession,
        designs: list[Candidate],
        *,
        person: str = "",
        blind: bool = False,
        facts: Mapping[str, Any] | None = None,
        seed: int | None = None,
    ) -> None:
        self._session, self.designs = session, tuple(designs)
        self._facts = dict(facts or {})
        self._random = random.Random(seed)
        self._lock = RLock()
        self._orders: dict[str, list[Candidate]] = {}  # by person
        self._servo: FeltServo | None = None
        self._cursor = 0
        self._feelings: dict[int, _Now] = {}  # by number of the world in the servo's rows
        self._world = 0
        self._blind = blind
        self.person = check_person(person)
        self.finished = False
        self.version = 0  #: another number after every change
        self.news: Callable[[str], None] = lambda text: None  #: is told what was rated or chosen, in words
        order = self._order
        self._pair = {"a": order[0], "b": order[1 % len(order)]}
        self._now = self._start(self._find_next(None))
        self._feelings[0] = self._now

    # what there is

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
        """What the present design is called before the person: its title, or a number while it is hidden."""
        return self._label(self.current)

    @property
    def _order(self) -> list[Candidate]:
        """The designs as they are numbered for this person: shuffled, so that numbers and turns tell nothing."""
        if self.person not in self._orders:
            self._orders[self.person] = self._random.sample(self.designs, len(self.designs))
        return self._orders[self.person]

    def describe(self) -> dict[str, Any]:
        """Everything that the page shows, as plain JSON types; nothing in it tells a hidden design."""
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
                **self._facts,
            }

    def _list_ratings(self) -> list[DesignRating]:
        """Those of this person of designs as they are now; while designs are hidden, those from when they were, too:
        another score would tell which is which."""
        now = {design.name: design.digest for design in self.designs}
        return [
            one
            for one in self._session.ratings()
            if one.person == self.person and now.get(one.design) == one.digest and (one.blind or not self._blind)
        ]

    def _label(self, design: Candidate) -> str:
        return f"Design {1 + self._order.index(design)}" if self._blind else design.title

    # what a person does

    def execute(self, command: Mapping[str, Any]) -> None:
        """What a page asks for: {"act": NAME, ...}. Raises InputError for what cannot be."""
        match command.get("act"):
            case "rate":
                self.rate(command.get("score"), str(command.get("feeling", "")))
            case "next":
                self.feel_next()
            case "feel":
                self.feel(self._design(command.get("number")))
            case "slot":
                self.feel(self._pair[_check_slot(command.get("slot"))])
            case "pair":
                self.set_pair(_check_slot(command.get("slot")), self._design(command.get("number")))
            case "person":
                self.set_person(str(command.get("person", "")))
            case "hide":
                self.set_blind(command.get("hide") is True)
            case "finish":
                self.finish()
            case other:
                known = "rate, next, feel, slot, pair, person, hide, finish"
                raise InputError(f"unknown act {quote(other)} of a feel session (known: {known})")

    def rate(self, score: object, feeling: str = "") -> None:
        """Keep what the person says of the design that is felt now, again if they change their mind.

        `feeling` names what they were shown: refused if another design is felt by then.
        """
        with self._lock:
            self._check_running()
            now = self._now
            if feeling and feeling != now.id:
                raise InputError("another design was chosen before this score arrived; it was not kept. Rate again")
            if isinstance(score, bool) or not isinstance(score, int) or not SCORES[0] <= score <= SCORES[1]:
                low, high = SCORES
                raise InputError(f"a score is a whole number from {low} to {high}; got {quote(score)}. Rate again")
            self._session.rate(
                now.trace.design.name, score, person=now.person, trace=now.file, feeling=now.id, blind=now.blind
            )
            now.score = score
            self._tell(f"{self.label}: rated {score}" + (f" by {self.person}" if self.person else ""))

    def feel_next(self) -> None:
        """Go on to one of the designs that this person rated least often, in random order."""
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
                self._world += 1
            else:
                self._feelings.pop(self._world)
            self._now = self._feelings[self._world] = self._start(design)
            self._tell(f"now: {self.label}")

    def feel_slot(self, slot: str) -> None:
        """Render what stands in slot "a" or "b"."""
        self.feel(self._pair[_check_slot(slot)])

    def set_pair(self, slot: str, design: Candidate) -> None:
        """Put `design` into slot "a" or "b"."""
        with self._lock:
            self._pair[slot] = design
            self._tell(f"{slot.upper()}: {self._label(design)}")

    def set_person(self, code: str) -> None:
        """Somebody else feels from now on: their ratings and their order are their own."""
        with self._lock:
            self._check_running()
            code = check_person(code)
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
            servo = self._servo
            if servo is None:
                return
            self._cursor, rows = servo.rows(self._cursor)
            worlds = rows[:, servo.layout["world"].start]
            for number, now in self._feelings.items():
                room = _LONGEST - len(now.trace)
                now.trace.extend(trace_rows(servo.layout, rows[worlds == number][: max(room, 0)]))
            ended = [number for number in self._feelings if len(worlds) and number < worlds[-1]]
            done = [self._feelings.pop(number) for number in ended]
        for now in done:
            self._keep(now, gently=True)

    def close(self) -> None:
        """Keep the traces of what was felt last; after the servo has ended."""
        with self._lock:
            left, self._feelings = list(self._feelings.values()), {}
        for now in left:
            self._keep(now, gently=False)

    def _keep(self, now: _Now, *, gently: bool) -> None:
        if len(now.trace):
            self._session.keep(
                now.trace, name=now.file, person=now.person, feeling=now.id, blind=now.blind, gently=gently
            )

    def _start(self, design: Candidate) -> _Now:
        file = self._session.reserve(design.name)
        return _Now(Trace(design), file, uuid4().hex[:12], self.person, self._blind)

    def _design(self, number: object) -> Candidate:
        order = self._order
        if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number <= len(order):
            raise UnknownName("number of a design", str(number)[:20], [str(1 + k) for k in range(len(order))])
        return order[number - 1]

    def _check_running(self) -> None:
        if self.finished:
            raise InputError("this feel session has ended; its report is being written")

    def _tell(self, text: str) -> None:
        self.version += 1
        self.news(text)


def _check_slot(slot: object) -> str:
    if slot not in _SLOTS:
        raise UnknownName("slot", str(slot)[:20], _SLOTS)
    return str(slot)
