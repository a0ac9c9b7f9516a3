"""One participant's session, as it is run: what is asked now, and every answer durable before the next is asked."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from math import atan2, degrees, hypot, isfinite
from time import monotonic
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, final

import numpy as np
from sqlalchemy import func, select
from sqlalchemy.engine import Connection, Engine
from sqlalchemy.exc import IntegrityError, SQLAlchemyError

from haptorb.arrays import Array
from haptorb.control.trips import CoilState, GuardState, Trip
from haptorb.devices.electromagnet import electromagnet
from haptorb.errors import InputError, RecordingError
from haptorb.runtime.trackers.pose_filter import describe_trip
from haptorb.version import __version__
from haptorb_study.codes import check_code, find_other_spelling, fold_spelling, is_reserved
from haptorb_study.copies import Kind, claim_contents
from haptorb_study.database import (
    events,
    lock,
    lock_session,
    participants,
    replies,
    sessions,
    studies,
    trials,
    try_begin,
    utc_now,
    withdrawn,
)
from haptorb_study.halt import StopCount, StopSwitch
from haptorb_study.order import plan, procedure_of
from haptorb_study.procedures import Answer, Procedure, Prompt, read_value
from haptorb_study.stored_rows import LONGEST_PLAN
from haptorb_study.study_file import Question, Study

if TYPE_CHECKING:
    from haptorb.runtime.servo import Servo

__all__ = ["OVER", "StoredSession", "TrialDevice", "TrialRunner"]


_AGAIN = 1.0  #: until the database is offered again what it did not take [s]


@final
class StoredSession:
    """Begins a session, or resumes one that was interrupted; use it in a `with` block.

    The procedure is rebuilt from the stored plan and the stored answers, so a resumed session asks exactly what the
    interrupted one would have asked. Raises RecordingError if the code has finished this study before, was withdrawn or
    is another spelling of one that is taken, if another experimenter runs the session, or if the database holds other
    data: real, `pilot` or `simulated` ones.

    history   what happened in it, oldest first: kind, trial (from 0), at, text
    """

    def __init__(
        self, engine: Engine, study: Study, code: str, *, simulated: bool = False, pilot: bool = False
    ) -> None:
        self.engine, self.study, self.code = engine, study, check_code(code)
        self.simulated = simulated
        self.kind: Kind = "simulated" if simulated else "pilot" if pilot else "real"
        self.history: list[dict[str, Any]] = []
        if is_reserved(self.code) != simulated:
            raise RecordingError(
                f"participant code '{self.code}' is a person's: a simulated participant is called SIM and a number"
                if simulated
                else f"participant code '{self.code}' is reserved for simulated participants: use another code"
            )
        self._late: list[dict[str, Any]] = []  # events that the database would not take yet
        self._again = 0.0  # when to offer them again
        try:
            self.id, stored = self._find_or_create()
            self._claim = lock_session(engine, self.id)
        except SQLAlchemyError as cause:
            raise _storage_error(cause) from cause
        try:
            self.procedure, self.number = self._replay(procedure_of(study, stored))
            self._replied = self._list_answered()
            self.history = self._list_events()
            self.resumed = self.number > 0
            self.note("resume" if self.resumed else "begin")
        except SQLAlchemyError as cause:
            self._claim.release()
            raise _storage_error(cause) from cause
        except BaseException:
            self._claim.release()
            raise

    def __repr__(self) -> str:
        who = f"{self.code}, SIMULATED" if self.simulated else self.code
        now = "everything is answered" if self.over else f"{self.number} trials answered"
        return f"<StoredSession {self.id} of {who}, study '{self.study.name}': {now}>"

    @property
    def prompt(self) -> Prompt | None:
        """What to ask now; None: done."""
        return self.procedure.prompt

    @property
    def question(self) -> Question | None:
        """What to ask in words now: before the first trial or after the last; None: nothing. People only."""
        if self.simulated:
            return None
        when = ("before",) if self.prompt is not None else ("before", "after")
        return next((q for q in self.study.questions if q.when in when and q.name not in self._replied), None)

    @property
    def over(self) -> bool:
        """Whether everything is answered."""
        return self.prompt is None and self.question is None

    @property
    def stored(self) -> int:
        """Answers that are stored, in trials and in words."""
        return self.number + len(self._replied)

    def reply(self, question: Question, text: str) -> None:
        """Keep `text`, the answer to `question`; InputError, and nothing kept, if it is no answer to it."""
        reply = question.check_reply(text)
        last = self.prompt is None and not self._open_questions(question)
        try:
            with self.engine.begin() as connection:
                self._catch_up(connection)
                row = {"session": self.id, "question": question.name, "reply": reply, "at": utc_now()}
                connection.execute(replies.insert().values(**row))
                if last:
                    connection.execute(sessions.update().where(sessions.c.id == self.id).values(ended=utc_now()))
        except SQLAlchemyError as cause:
            raise _storage_error(cause) from cause
        self._late.clear()
        self._replied.add(question.name)

    def answer(
        self, answer: Answer, *, safety: Sequence[dict[str, Any]] = (), recording: str | None = None,
        driver: str | None = None,
    ) -> None:  # fmt: skip
        """Keep `answer`: on the disk when this returns. InputError, and nothing kept, if it may not be answered so.

        `driver` of the device shows whether it was simulated.
        """
        prompt = self.prompt
        after = self.procedure.record_answer(answer)
        assert prompt is not None
        x, y, z = answer.position or (None, None, None)
        row = {
            "session": self.id,
            "number": self.number,
            "prompt": json.dumps(prompt.row(), ensure_ascii=False),
            "answer": answer.value,
            "x": x,
            "y": y,
            "z": z,
            "seconds": answer.seconds,
            "safety": json.dumps(list(safety), ensure_ascii=False),
            "recording": recording,
            "answered": utc_now(),
            "driver": driver,
        }
        try:
            with self.engine.begin() as connection:
                self._catch_up(connection)
                connection.execute(trials.insert().values(**row))
                if after.prompt is None and (self.simulated or not self._open_questions()):
                    connection.execute(sessions.update().where(sessions.c.id == self.id).values(ended=utc_now()))
        except IntegrityError as cause:
            raise RecordingError(
                f"trial {self.number + 1} of session {self.id} was already answered; start again"
            ) from cause
        except SQLAlchemyError as cause:
            raise _storage_error(cause) from cause
        self._late.clear()
        self.procedure, self.number = after, self.number + 1

    def note(self, kind: str, text: str = "", *, at: str | None = None, later: bool = False) -> None:
        """Keep that something happened, now or `at` that time of day: pause, abort, repeat ...

        With `later`, what the database does not take now is stored with the next entry that it takes, or by
        `keep_late`, and nothing is raised: what was done must not wait for the record of it.
        """
        text = text.replace("\0", "").encode("utf-8", "backslashreplace").decode()  # a record is never refused
        happened = {"kind": kind, "trial": self.number, "at": at or utc_now(), "text": text}
        self._late.append({"session": self.id, **happened})
        self.history.append(happened)
        try:
            with self.engine.begin() as connection:
                self._catch_up(connection)
        except SQLAlchemyError as cause:
            if later:
                return
            self._late.pop()
            self.history.pop()
            raise _storage_error(cause) from cause
        self._late.clear()

    def keep_late(self) -> None:
        """Try once a second to keep what the database has not taken yet; this waits 50 ms at most."""
        if not self._late or monotonic() < self._again:
            return
        self._again = monotonic() + _AGAIN
        with suppress(SQLAlchemyError):
            with try_begin(self.engine) as connection:
                self._catch_up(connection)
            self._late.clear()

    def abort(self, reason: str = "") -> None:
        """End permanently: the answers stay, and the session cannot be resumed."""
        self.note("abort", reason)
        try:
            with self.engine.begin() as connection:
                done = {"ended": utc_now(), "aborted": True}
                connection.execute(sessions.update().where(sessions.c.id == self.id).values(**done))
        except SQLAlchemyError as cause:
            raise _storage_error(cause) from cause

    def close(self) -> None:
        """Release the session for another station; may be called twice."""
        try:
            if self._late:
                with self.engine.begin() as connection:
                    self._catch_up(connection)
                self._late.clear()
        except SQLAlchemyError as cause:
            raise RecordingError(
                f"session {self.id}: {len(self._late)} events (pauses, safety events) could not be stored"
            ) from cause
        finally:
            self._claim.release()

    def _catch_up(self, connection: Connection) -> None:
        """Keep the events that are late, in the transaction of `connection`."""
        if self._late:
            connection.execute(events.insert(), self._late)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _find_or_create(self) -> tuple[int, dict[str, Any]]:
        """(id, plan) of the session of this code in this study."""
        study = self.study
        with self.engine.begin() as connection:
            lock(connection)  # two stations must not count participants at the same moment
            claim_contents(connection, self.kind)
            if not connection.execute(select(studies.c.digest).where(studies.c.digest == study.digest)).first():
                connection.execute(studies.insert().values(digest=study.digest, name=study.name, text=study.text))
            people = select(participants.c.code, participants.c.id).where(participants.c.study == study.digest)
            known = {str(code): int(person) for code, person in connection.execute(people).all()}
            if self.code in known:
                return self._resume(connection, known[self.code])
            gone = select(withdrawn.c.code, withdrawn.c.ordinal).where(withdrawn.c.study == study.digest)
            left = {str(code): int(ordinal) for code, ordinal in connection.execute(gone).all()}
            self._check_free(known, left)
            newest = connection.execute(
                select(func.max(participants.c.ordinal)).where(participants.c.study == study.digest)
            ).scalar()
            ordinal = 1 + max(-1 if newest is None else int(newest), *left.values(), -1)
            drawn = plan(study, ordinal)
            written = json.dumps(drawn)
            if len(written) > LONGEST_PLAN:
                raise InputError(
                    f"study '{study.name}': the plan of one session is longer than {LONGEST_PLAN // 2**20} MiB, some "
                    "250,000 trials: reduce the repetitions, set-points or conditions"
                )
            new = participants.insert().values(study=study.digest, code=self.code, ordinal=ordinal)
            person = connection.execute(new).inserted_primary_key
            assert person is not None
            made = connection.execute(
                sessions.insert().values(
                    participant=person[0],
                    plan=written,
                    simulated=self.simulated,
                    started=utc_now(),
                    versions=json.dumps({"haptorb": __version__, "plan": study.plan.digest if study.plan else ""}),
                )
            ).inserted_primary_key
            assert made is not None
            return int(made[0]), drawn

    def _check_free(self, known: Iterable[str], left: Iterable[str]) -> None:
        """RecordingError if a new person may not have this code, beside the `known` ones and those who `left`."""
        gone = {fold_spelling(code): code for code in left}.get(fold_spelling(self.code))
        if gone is not None:  # safety: study-withdrawn
            raise RecordingError(
                f"participant code '{gone}' was withdrawn from study '{self.study.name}', with all its data: nothing "
                "is stored under it again. If the person takes part again, use a new code"
            )
        other = find_other_spelling(self.code, known)
        if other is not None:
            raise RecordingError(
                f"participant code '{self.code}' is another spelling of '{other}' (capitals, look-alike letters or "
                f"digits, zeros, marks): enter '{other}' to continue that session, or use a code that differs more"
            )

    def _resume(self, connection: Connection, person: int) -> tuple[int, dict[str, Any]]:
        row = connection.execute(select(sessions).where(sessions.c.participant == person)).one()
        if row.ended is not None:
            how = "aborted" if row.aborted else "finished"
            raise RecordingError(
                f"participant code '{self.code}' has {how} study '{self.study.name}' in this database: use another code"
            )
        if row.simulated != self.simulated:
            kind = "simulated" if row.simulated else "real"
            raise RecordingError(f"participant code '{self.code}' belongs to a {kind} participant: use another code")
        return int(row.id), json.loads(row.plan)

    def _open_questions(self, but: Question | None = None) -> list[str]:
        """Names of the questions that are still unanswered, but for one."""
        return [q.name for q in self.study.questions if q.name not in self._replied and q != but]

    def _list_answered(self) -> set[str]:
        """Names of the questions that were answered."""
        query = select(replies.c.question).where(replies.c.session == self.id)
        with self.engine.connect() as connection:
            return set(connection.execute(query).scalars())

    def _list_events(self) -> list[dict[str, Any]]:
        """What happened before."""
        query = (
            select(events.c.kind, events.c.trial, events.c.at, events.c.text)
            .where(events.c.session == self.id)
            .order_by(events.c.id)
        )
        with self.engine.connect() as connection:
            return [dict(row) for row in connection.execute(query).mappings()]

    def _replay(self, procedure: Procedure) -> tuple[Procedure, int]:
        """The procedure after all stored answers, and the number of the next trial."""
        query = select(trials).where(trials.c.session == self.id).order_by(trials.c.number)
        with self.engine.connect() as connection:
            rows = connection.execute(query).all()
        for number, row in enumerate(rows):
            asked = procedure.prompt
            if row.number != number or asked is None or Prompt.read(json.loads(row.prompt)) != asked:
                raise RecordingError(
                    f"session {self.id}: trial {row.number + 1} does not match the plan; the data were changed"
                )
            place = None if row.x is None else (row.x, row.y, row.z)
            procedure = procedure.record_answer(Answer(read_value(row.answer), place, row.seconds))
        return procedure, len(rows)


def _storage_error(cause: SQLAlchemyError) -> RecordingError:
    text = str(getattr(cause, "orig", None) or cause).splitlines()[0]
    return RecordingError(
        f"the answer could not be stored: {text}; no partial data were written. Fix the cause, then resume"
    )


# --------------------------------------------------------------------------------------------------
# The device in a session: a prompted set-point is rendered on the real loop, and what happens is reported.


_FELT_FORCE, _FELT_TORQUE = 0.1, 0.002  #: asked of the coils [N], [N·m]
_FELT_MOTION = 0.5e-3  #: of the tool since the stimulus began [m]
_PATIENCE = 1.0  #: that a simulated hand rests where it is while this program waits for a processor [s]


@final
class TrialDevice:
    """A running servo, as a trial needs it. With the pointer as tracker the pen is steered from the keyboard."""

    def __init__(self, study: Study, servo: Servo) -> None:
        device = electromagnet(servo.device, "a study")
        self.study, self.servo = study, servo
        self.contact = device.contact_distance
        self.limit = degrees(device.workspace_half_angle)
        self.steered = servo.tracker == "pointer"
        self.simulated = servo.driver == "sim"
        self._pen = (0.0, 0.0)  #: (x, y): angle from the top towards +x and +y [deg]
        self.trips: list[dict[str, Any]] = []  #: since the loop began, as far as `look` has looked
        self._cursor, self._reason = 0, 0.0
        self._since = 0.0
        self._first: tuple[float, float, float] | None = None  # where the tool was when the stimulus began
        self._before = -1  # changes of the world before the stimulus
        self._recording = True

    def record(self, on: bool) -> None:
        """Have the tool's course recorded, or leave it out of the recording."""
        if on != self._recording:
            self._recording = on
            self.servo.pause_recording(not on)

    def begin(self, prompt: Prompt) -> None:
        """Render the first interval of `prompt`; the course counts from here."""
        self._since = self._time()
        self.interval(prompt, 1)

    def interval(self, prompt: Prompt, which: int) -> None:
        """Render interval `which`, 1 or 2, of a comparison; for other prompts the only one."""
        condition, level = prompt.condition, prompt.level or None
        if prompt.interval and which != prompt.interval:
            condition = prompt.other or condition
            level = self.study.levels.reference if self.study.levels else None
        number = prompt.set_point or self.study.points[0].number
        self._first, self._before = None, self._count_changes()
        self.servo.set_world(self.study.world_name, self.study.values(condition, number, level))

    def rest(self) -> None:
        """Between trials: nothing is felt."""
        self.servo.set_world("nothing")

    @property
    def pen(self) -> tuple[float, float]:
        """Where the hand wants the pen: angle from the top towards +x and +y [deg]."""
        return self._pen

    def steer(self, dx: float, dy: float) -> None:
        """Move the pen by so many degrees; it stays within the workspace."""
        self.aim(self._pen[0] + dx, self._pen[1] + dy)

    def aim(self, x: float, y: float) -> None:
        """The pen at angle (x, y) from the top [deg]; it stays within the workspace."""
        if not (isfinite(x) and isfinite(y)):
            raise InputError("the pen's position must be two finite angles")
        theta = hypot(x, y)
        if theta > self.limit:
            x, y = x * self.limit / theta, y * self.limit / theta
        self._pen = (x, y)

    def refresh(self) -> None:
        """Say again where the hand is, before the pose counts as lost; ServoError if the loop ended."""
        self.servo.check()
        self.hold()

    def hold(self) -> None:
        """Say again where the hand is; of a pen that is steered from here."""
        if self.steered:
            x, y = np.radians(self._pen)
            theta, phi = hypot(x, y), atan2(y, x)
            way = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
            # A little above contact: the hand rests on the dome, it does not dig in.
            self.servo.hand.point(way * self.contact, patience=_PATIENCE)

    @property
    def position(self) -> tuple[float, float, float] | None:
        """Where the tool's magnet is now [m]; None where its pose is not valid."""
        row, layout = self.servo.latest(), self.servo.layout
        if row is None or row[layout["valid"]][0] < 1:
            return None
        x, y, z = row[layout["p"]].tolist()
        return x, y, z

    @property
    def force(self) -> Array | None:
        """(3,) force on the tool now [N]; None where unknown."""
        row, layout = self.servo.latest(), self.servo.layout
        if row is None:
            return None
        force: Array = row[layout["given"]][:3]
        return force if np.isfinite(force).all() else None

    def is_felt(self) -> bool:
        """Whether the stimulus is felt: 0.1 N or 2 mN·m is asked now, or the tool moved by 0.5 mm since it began."""
        place, row = self.position, self.servo.latest()
        if place is None or row is None or self._count_changes() == self._before:
            return False
        self._first = self._first or place
        asked = row[self.servo.layout["asked"]]
        force, torque = float(np.linalg.norm(asked[:3])), float(np.linalg.norm(asked[3:]))
        moved = float(np.linalg.norm(np.subtract(place, self._first)))
        return force >= _FELT_FORCE or torque >= _FELT_TORQUE or moved >= _FELT_MOTION

    @property
    def switched_off(self) -> bool:
        """Whether the guard has the coils off."""
        row = self.servo.latest()
        return row is None or row[self.servo.layout["guard"]][0] in (0, 4)

    @property
    def unconfirmed(self) -> bool:
        """Whether the coils were switched off, and the device has not confirmed it."""
        row = self.servo.latest()
        return row is not None and bool(row[self.servo.layout["coil_state"]][0] == CoilState.UNKNOWN)

    def look(self) -> None:
        """Add new trips to `trips`: read off the loop's rows, which costs less than its report."""
        before = self._cursor
        self._cursor, rows = self.servo.rows(before)
        if not len(rows):
            return
        layout = self.servo.layout
        t, guard, code = (rows[:, layout[name]][:, 0] for name in ("t", "guard", "trip"))
        reason = np.where(guard == GuardState.TRIPPED, code, 0.0)
        fresh = np.flatnonzero((reason != 0) & (reason != np.concatenate([[self._reason], reason[:-1]])))
        self._reason = float(reason[-1])
        trips = [(float(t[n]), Trip(int(reason[n]))) for n in fresh]
        tracker = self.servo.tracker
        found = [{"t": at, "code": trip.name, "reason": describe_trip(trip, tracker)} for at, trip in trips]
        if self._cursor - before > len(rows) and before:
            found.append({"t": float(t[0]), "code": "NOT_WATCHED", "reason": "rows were lost: trips may be missing"})
        self.trips += found

    def course(self, recording: str | None) -> str | None:
        """The part of the recording that is this trial: FILE#t=from,to on the loop's clock [s]."""
        return f"{recording}#t={self._since:.3f},{self._time():.3f}" if recording else None

    def _count_changes(self) -> int:
        row = self.servo.latest()
        return -1 if row is None else int(row[self.servo.layout["world"]][0])

    def _time(self) -> float:
        row = self.servo.latest()
        return 0.0 if row is None else float(row[self.servo.layout["t"]][0])


# --------------------------------------------------------------------------------------------------
# A session, independent of its interface: rests, trials, pauses, questions; commands in, state out, no keys, no page.
#
# The terminal and the pages both drive this, so that both keep the same data. One thread calls it.


OVER = ("done", "left", "aborted")  #: states after which nothing comes
_TRIAL = ("running", "time is up")
_RECORDED = (*_TRIAL, "pause")
_AFTER = 1.0  #: time after a stop, or another end of a trial, that is recorded [s]


def _ignore_event(kind: str, facts: dict[str, Any]) -> None:
    """A listener that does nothing."""


@final
class TrialRunner:
    """Runs `session` on `trial_device`. `tick` is to be called some fifty times a second.

    A Stop is carried out by `halt`, at once; here it becomes the state "paused", from any state, and a record.
    A trial in which the device was off, for any reason, is not answered: it starts again when the device is on.

    state      question, pause (between trials), break, running, time is up, device off, paused, done, left, aborted
    recording  file that the tool's course goes to; its name is kept with every trial
    mark       is called for every event, as it happens: for streams to other equipment
    halt       knows the servo and who stopped it; None: one of its own
    """

    def __init__(
        self, session: StoredSession, trial_device: TrialDevice, recording: str | None = None,
        mark: Callable[[str, dict[str, Any]], None] = _ignore_event, clock: Callable[[], float] = monotonic,
        halt: StopSwitch | None = None,
    ) -> None:  # fmt: skip
        self.session, self.trial_device = session, trial_device
        if halt is None:
            halt = StopSwitch()
            halt.attach(trial_device.servo, halt.ask())
        self.halt = halt
        self.which = 1  #: interval that is felt
        self.seconds = 0.0  #: time in this trial without pauses [s]
        self.trips: list[dict[str, Any]] = []  #: safety events of the session, with the trial each came in
        self._recording, self._mark, self._clock = recording, mark, clock
        self.repeats = 0  #: how often this trial was restarted
        self._again = ""  # why it must start again
        self._felt: set[int] = set()  # intervals of this trial in which something was felt
        self._during: list[dict[str, Any]] = []  # trips in this trial, however often it began
        self._until = 0.0  # end of a rest
        self._last = clock()
        self._trip_count = 0  # trips of the device that are kept
        self._paused_from, self._rest_left = "", 0.0
        self._moved = clock()  # when something last happened that is recorded
        self.state = "pause"
        self._continue()
        self.apply_stop()

    @property
    def prompt(self) -> Prompt | None:
        """What is asked now, or next."""
        return self.session.prompt

    @property
    def question(self) -> Question | None:
        """What is asked in words now."""
        return self.session.question if self.state == "question" else None

    @property
    def rest_left(self) -> float:
        """What is left of a rest [s]."""
        if self.state == "paused":
            return self._rest_left
        return max(0.0, self._until - self._clock()) if self.state in ("pause", "break") else 0.0

    def tick(self) -> None:
        """Time passes: rests end, time limits are noticed, and trips of the device are kept."""
        now = self._clock()
        passed, self._last = now - self._last, now
        self.apply_stop()
        self._notice_off()
        self.session.keep_late()
        rested = self.state in ("pause", "break") and now >= self._until
        if rested or (self.state == "device off" and not self.trial_device.switched_off):
            self._begin()
        elif self.state == "running":
            self.seconds += passed
            self._notice_felt()
            limit = self.session.study.trials.time_limit
            if limit is not None and self.seconds > limit:
                self.trial_device.rest()
                self.state = "time is up"
                self._mark("time is up", {"trial": self.session.number + 1})
        elif self.state == "time is up":
            self.seconds += passed
        if self.state in _RECORDED:
            self._moved = now
        self.trial_device.record(now - self._moved < _AFTER)

    def apply_stop(self) -> None:
        """Pause if Stop was given, by whomever, and keep who gave it. The coils are off already."""
        if self.halt.active and self.state not in ("paused", *OVER):
            self._rest_left = self.rest_left
            if self.state in _TRIAL:
                self._again = f"stopped {self.halt.why}".rstrip()
                self.state = "device off"
            self._paused_from, self.state = self.state, "paused"
        for stopped in self.halt.take():
            self._note("pause", stopped.why, stopped.at)

    def answer(self, value: int | float | None) -> None:
        """Store the answer, durably, and continue. A wrong answer is an InputError; the trial continues."""
        self.apply_stop()
        self._notice_off()
        if self.state == "device off":
            raise InputError(
                "the device is off, so this answer does not count: please wait; the trial starts again when it is on"
            )
        prompt = self.prompt
        if self.state not in _TRIAL or prompt is None:
            raise InputError(f"no answer is expected now ({self.state})")
        if value is None and prompt.wants_number:
            raise InputError("choose the number first, then answer")
        self._check_felt(prompt)
        number = self.session.number
        answer = Answer(value, self.trial_device.position, self.seconds)
        self.session.answer(
            answer,
            safety=self._during,
            recording=self.trial_device.course(self._recording),
            driver=self.trial_device.servo.driver,
        )
        self._mark("answer", {"trial": number + 1, "answer": value, "set_point": prompt.set_point})
        self.repeats, self._again, self._during = 0, "", []
        self._continue()

    def reply(self, text: str) -> None:
        """Keep the answer to the question in words."""
        self.apply_stop()
        question = self.question
        if question is None:
            raise InputError("no question is asked now")
        self.session.reply(question, text)
        self._mark("reply", {"question": question.name})
        self._continue()

    def skip(self) -> None:
        """End a break early; a pause that the study file sets between trials stays."""
        self.apply_stop()
        if self.state == "break":
            self._begin()

    def interval(self, which: int | None) -> None:
        """Let interval `which`, 1 or 2, be felt."""
        self.apply_stop()
        prompt = self.prompt
        if not isinstance(which, int) or which not in (1, 2) or prompt is None or not prompt.interval:
            raise InputError("this trial has no such interval")
        if self.state == "running":
            self._notice_felt()
            self.which = which
            self.trial_device.interval(prompt, which)
            self._mark("interval", {"trial": self.session.number + 1, "interval": which})

    def pause(self, why: str = "") -> None:
        """Coils off until `resume`; a rest is suspended meanwhile."""
        if self.state not in OVER:
            if not self.halt.active:
                self.halt.stop(why)  # safety: study-pause
            self.apply_stop()

    def resume(self, asked: StopCount | None = None) -> None:
        """Continue where `pause` was, in a trial at its beginning; the coils come back from zero.

        InputError, and nothing changes, if Stop was given after `asked`; None: it is asked for now.
        """
        self.apply_stop()
        if self.state != "paused":
            return
        self.halt.engage(asked or self.halt.ask())
        self.state = self._paused_from
        self._until = self._clock() + self._rest_left
        self._last = self._clock()
        self._note("resume")

    def repeat(self) -> None:
        """Start the trial again, with its full time limit; the repetition is stored."""
        self.apply_stop()
        if self.state not in _TRIAL or self.prompt is None:
            raise InputError(f"there is no trial to repeat now ({self.state})")
        self._again = "by the experimenter"
        self._begin()

    def engage(self, asked: StopCount | None = None) -> None:
        """After a trip: coils on again, unless the guard refuses, or Stop was given after `asked`; None: now."""
        self.apply_stop()
        if self.state == "paused":
            raise InputError("the session is paused: resume switches the coils on")
        self.halt.engage(asked or self.halt.ask())

    def leave(self) -> None:
        """End for now: the session can be resumed at this trial. Coils off first of all."""
        if self.state not in OVER:
            self.halt.stop(None)
            self.apply_stop()
            self._note("leave")
            self.state = "left"

    def abort(self, why: str = "") -> None:
        """End the session. Coils off first of all, even if the end cannot be stored."""
        if self.state not in OVER:
            self.halt.stop(None)
            self.apply_stop()
            self.session.abort(why)
            self._mark("abort", {"trial": self.session.number + 1})
            self.state = "aborted"

    def _continue(self) -> None:
        """What follows an answer: a question, a rest, a trial or the end."""
        self.trial_device.rest()
        prompt = self.prompt
        if self.session.question is not None:
            self.state = "question"
        elif prompt is None:
            self.state = "done"
            self._mark("done", {})
        else:
            wait = prompt.pause or (self.session.study.trials.pause_seconds if self.session.number else 0.0)
            self._until = self._clock() + wait
            self._moved = self._clock()
            self.state = "break" if prompt.pause else "pause"
            if prompt.pause:
                self._mark("break", {"seconds": wait})
            if not wait:
                self._begin()

    def _begin(self) -> None:
        """Let the trial begin, or wait until the device is on."""
        prompt = self.prompt
        assert prompt is not None
        self._record_trips()
        if self.trial_device.switched_off:
            self._wait_for_device()
            return
        self.state, self.which, self.seconds = "running", 1, 0.0
        self._felt.clear()
        self._last = self._moved = self._clock()
        self.trial_device.record(True)
        self.trial_device.begin(prompt)
        if self._again:
            self.repeats += 1
            self._note("repeat", self._again)
            self._again = ""
        self._mark(
            "trial",
            {"trial": self.session.number + 1, "set_point": prompt.set_point, "condition": prompt.condition,
             "level": prompt.level, "interval": prompt.interval, "phase": prompt.phase},
        )  # fmt: skip

    def _notice_felt(self) -> None:
        if self.which not in self._felt and self.trial_device.is_felt():
            self._felt.add(self.which)

    def _check_felt(self, prompt: Prompt) -> None:
        """InputError if the answer would judge what was not felt; a trial whose time is up then starts again."""
        if self.state == "running":
            self._notice_felt()
        wanted = (
            {1, 2} if prompt.interval else {1} if self.session.study.procedure in ("rating", "magnitude") else set()
        )
        missing = sorted(wanted - self._felt)
        if not missing:
            return
        what = f"interval {missing[0]}" if prompt.interval else "this"
        if self.state == "time is up":
            self._again = f"answered before {what} was felt"
            self._begin()
            raise InputError(f"{what} was not felt before the time was up: not stored. The trial starts again")
        raise InputError(f"{what} has not been felt yet: not stored. Move the tool to feel it, then answer")

    def _wait_for_device(self) -> None:
        self.trial_device.rest()
        self.state = "device off"
        self._mark("device off", {"trial": self.session.number + 1})

    def _notice_off(self) -> None:
        """Keep new trips; a trial in which the device was off waits until it is on, then starts again."""
        fresh = [str(trip["code"]) for trip in self._record_trips() if trip["code"] != "NOT_WATCHED"]
        if self.state in _TRIAL and (fresh or self.trial_device.switched_off):  # safety: study-answer-off
            self._again = f"the device was off: {', '.join(fresh)}" if fresh else "the device was off"
            self._wait_for_device()

    def _record_trips(self) -> list[dict[str, Any]]:
        """Keep new trips, which are returned; those of a trial are kept with its answer besides."""
        self.trial_device.look()
        fresh = self.trial_device.trips[self._trip_count :]
        self._trip_count += len(fresh)
        for trip in fresh:
            if trip["code"] == "STOPPED":  # by hand, which is no safety event
                continue
            if self.state in _TRIAL:
                self._during.append(trip)
            known = {**trip, "trial": self.session.number}
            self.trips.append(known)
            self.session.note("safety", f"{trip['code']}: {trip['reason']}", later=True)
            self._mark("safety", {**known, "trial": self.session.number + 1})
        return fresh

    def _note(self, kind: str, text: str = "", at: str | None = None) -> None:
        self.session.note(kind, text, at=at, later=True)
        self._mark(kind, {"trial": self.session.number + 1} | ({"why": text} if text else {}))
