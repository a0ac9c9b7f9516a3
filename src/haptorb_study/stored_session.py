"""Stored session of one participant: current prompt; every answer is durable before the next prompt."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from contextlib import suppress
from time import monotonic
from types import TracebackType
from typing import Any, Self, final

from sqlalchemy import func, select
from sqlalchemy.engine import Connection, Engine
from sqlalchemy.exc import IntegrityError, SQLAlchemyError

from haptorb.errors import InputError, RecordingError
from haptorb.version import __version__
from haptorb_study.data_kind import Kind, claim_contents
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
    withdrawn,
)
from haptorb_study.json_values import utc_now
from haptorb_study.order import plan, procedure_of
from haptorb_study.participant_codes import check_code, find_other_spelling, fold_spelling, is_reserved
from haptorb_study.procedures import Procedure
from haptorb_study.prompts import Answer, Prompt, read_value
from haptorb_study.stored_rows import MAX_PLAN_CHARACTERS
from haptorb_study.study_file import Study
from haptorb_study.study_tables import Question

__all__ = ["StoredSession"]


_RETRY_INTERVAL_S = 1.0  #: interval of attempts to store delayed events [s]


@final
class StoredSession:
    """Starts a session, or resumes an interrupted one; to be used in a `with` block.

    The procedure is rebuilt from the stored plan and answers, so a resumed session continues with exactly the prompts
    of the interrupted one. Raises RecordingError if the code has finished this study before, was withdrawn or is
    another spelling of one that is taken, if another experimenter runs the session, or if the database holds other
    data: real, `pilot` or `simulated` ones.

    history   its events, oldest first: kind, trial (from 0), at, text
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
                f"participant code '{self.code}' is a real participant's: a simulated one is called SIM and a number"
                if simulated
                else f"participant code '{self.code}' is reserved for simulated participants: use another code"
            )
        self._delayed_events: list[dict[str, Any]] = []  # events not stored yet
        self._next_retry = 0.0  # time of the next attempt
        try:
            self.id, stored = self._find_or_create()
            self._lock = lock_session(engine, self.id)
        except SQLAlchemyError as cause:
            raise _storage_error(cause) from cause
        try:
            self.procedure, self.number = self._replay(self._read_plan(stored))
            self._replied = self._list_answered()
            self.history = self._list_events()
            self.resumed = self.number > 0
            self.record_event("resume" if self.resumed else "begin")
        except SQLAlchemyError as cause:
            self._lock.release()
            raise _storage_error(cause) from cause
        except BaseException:
            self._lock.release()
            raise

    def __repr__(self) -> str:
        who = f"{self.code}, SIMULATED" if self.simulated else self.code
        now = "everything is answered" if self.over else f"{self.number} trials answered"
        return f"<StoredSession {self.id} of {who}, study '{self.study.name}': {now}>"

    @property
    def prompt(self) -> Prompt | None:
        """Current prompt; None: done."""
        return self.procedure.prompt

    @property
    def question(self) -> Question | None:
        """Current question, before the first trial or after the last; None: none. Not for simulated participants."""
        if self.simulated:
            return None
        when = ("before",) if self.prompt is not None else ("before", "after")
        return next((q for q in self.study.questions if q.when in when and q.name not in self._replied), None)

    @property
    def over(self) -> bool:
        """Whether all trials and questions are answered."""
        return self.prompt is None and self.question is None

    @property
    def stored(self) -> int:
        """Number of stored answers and replies."""
        return self.number + len(self._replied)

    def reply(self, question: Question, text: str) -> None:
        """Store `text`, the reply to `question`; InputError, and nothing stored, if it is invalid."""
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
        self._delayed_events.clear()
        self._replied.add(question.name)

    def answer(
        self, answer: Answer, *, safety: Sequence[dict[str, Any]] = (), recording: str | None = None,
        driver: str | None = None,
    ) -> None:  # fmt: skip
        """Store `answer`, durable on return. InputError, and nothing stored, if it is invalid.

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
        self._delayed_events.clear()
        self.procedure, self.number = after, self.number + 1

    def record_event(self, kind: str, text: str = "", *, at: str | None = None, later: bool = False) -> None:
        """Store an event, now or with the time of day `at`: pause, abort, repeat ...

        With `later`, an event that cannot be stored now is stored with the next one or by `store_late_events`, and
        nothing is raised: the action it records must not be delayed.
        """
        text = text.replace("\0", "").encode("utf-8", "backslashreplace").decode()  # a record is never refused
        happened = {"kind": kind, "trial": self.number, "at": at or utc_now(), "text": text}
        self._delayed_events.append({"session": self.id, **happened})
        self.history.append(happened)
        try:
            with self.engine.begin() as connection:
                self._catch_up(connection)
        except SQLAlchemyError as cause:
            if later:
                return
            self._delayed_events.pop()
            self.history.pop()
            raise _storage_error(cause) from cause
        self._delayed_events.clear()

    def store_late_events(self) -> None:
        """Retry once per second to store delayed events; blocks for 50 ms at most."""
        if not self._delayed_events or monotonic() < self._next_retry:
            return
        self._next_retry = monotonic() + _RETRY_INTERVAL_S
        with suppress(SQLAlchemyError):
            with try_begin(self.engine) as connection:
                self._catch_up(connection)
            self._delayed_events.clear()

    def abort(self, reason: str = "") -> None:
        """End permanently: answers remain, but the session cannot be resumed."""
        self.record_event("abort", reason)
        try:
            with self.engine.begin() as connection:
                done = {"ended": utc_now(), "aborted": True}
                connection.execute(sessions.update().where(sessions.c.id == self.id).values(**done))
        except SQLAlchemyError as cause:
            raise _storage_error(cause) from cause

    def close(self) -> None:
        """Release the session for another station; may be called repeatedly."""
        try:
            if self._delayed_events:
                with self.engine.begin() as connection:
                    self._catch_up(connection)
                self._delayed_events.clear()
        except SQLAlchemyError as cause:
            raise RecordingError(
                f"session {self.id}: {len(self._delayed_events)} events (pauses, safety events) could not be stored"
            ) from cause
        finally:
            self._lock.release()

    def _catch_up(self, connection: Connection) -> None:
        """Store delayed events in the transaction of `connection`."""
        if self._delayed_events:
            connection.execute(events.insert(), self._delayed_events)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _find_or_create(self) -> tuple[int, dict[str, Any]]:
        """(id, plan) of the session of this code in this study, created if new."""
        study = self.study
        with self.engine.begin() as connection:
            lock(connection)  # two stations must not number participants concurrently
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
            if len(written) > MAX_PLAN_CHARACTERS:
                raise InputError(
                    f"study '{study.name}': the plan of one session is longer than {MAX_PLAN_CHARACTERS // 2**20} MiB, "
                    "some 250,000 trials: reduce the repetitions, set-points or conditions"
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
        """Raise RecordingError if the code is taken or withdrawn, or another spelling of such a code."""
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
        """Names of the unanswered questions, except one."""
        return [q.name for q in self.study.questions if q.name not in self._replied and q != but]

    def _list_answered(self) -> set[str]:
        """Names of the answered questions."""
        query = select(replies.c.question).where(replies.c.session == self.id)
        with self.engine.connect() as connection:
            return set(connection.execute(query).scalars())

    def _list_events(self) -> list[dict[str, Any]]:
        """Stored events, oldest first."""
        query = (
            select(events.c.kind, events.c.trial, events.c.at, events.c.text)
            .where(events.c.session == self.id)
            .order_by(events.c.id)
        )
        with self.engine.connect() as connection:
            return [dict(row) for row in connection.execute(query).mappings()]

    def _read_plan(self, stored: dict[str, Any]) -> Procedure:
        """The procedure of the stored plan; RecordingError for a plan that this program did not store."""
        try:
            return procedure_of(self.study, stored)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as cause:
            raise RecordingError(
                f"session {self.id}: its plan cannot be read ({type(cause).__name__}: {cause}); the data were changed"
            ) from cause

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
