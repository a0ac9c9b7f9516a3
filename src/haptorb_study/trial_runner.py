"""Trial state machine of a session: breaks, trials, pauses and questions, independent of terminal and pages.

Shared by terminal and pages, so that both store the same data. Called by one thread.
"""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic
from typing import Any, final

from haptorb.errors import InputError
from haptorb_study.prompts import Answer, Prompt
from haptorb_study.stop_switch import StopCount, StopSwitch
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_tables import Question
from haptorb_study.trial_device import TrialDevice

__all__ = ["OVER", "TrialRunner"]


OVER = ("done", "left", "aborted")  #: final states
_IN_TRIAL = ("running", "time is up")
_RECORDED_STATES = (*_IN_TRIAL, "pause")
_RECORDING_TAIL_S = 1.0  #: recording continues for so long after a trial ends [s]


def _ignore_event(kind: str, facts: dict[str, Any]) -> None:
    """Ignore an event."""


@final
class TrialRunner:
    """Runs `session` on `trial_device`; `tick` is to be called about fifty times per second.

    `halt` executes a Stop at once; here it leads to the state "paused", from any state, and is recorded.
    A trial in which the device was off, for any reason, cannot be answered: it restarts once the device is on.

    state      question, pause (between trials), break, running, time is up, device off, paused, done, left, aborted
    recording  file of the recording; its name is stored with every trial
    mark       is called for every event, for streams to other equipment
    halt       stop switch; None: a new one
    """

    def __init__(
        self, session: StoredSession, trial_device: TrialDevice, recording: str | None = None,
        mark: Callable[[str, dict[str, Any]], None] = _ignore_event, clock: Callable[[], float] = monotonic,
        halt: StopSwitch | None = None,
    ) -> None:  # fmt: skip
        self.session, self.trial_device = session, trial_device
        if halt is None:
            halt = StopSwitch()
            halt.attach(trial_device.servo, halt.read_count())
        self.halt = halt
        self.which = 1  #: interval being rendered
        self.seconds = 0.0  #: time in this trial without pauses [s]
        self.trips: list[dict[str, Any]] = []  #: safety events of the session, with their trial
        self._recording, self._mark, self._clock = recording, mark, clock
        self.repeats = 0  #: number of restarts of this trial
        self._restart_reason = ""  # reason for the next restart
        self._felt_intervals: set[int] = set()  # intervals of this trial that have been felt
        self._trial_trips: list[dict[str, Any]] = []  # trips in this trial, with all its restarts
        self._break_end = 0.0  # end of a pause or break
        self._last_tick = clock()
        self._trip_count = 0  # trips of the device that are stored
        self._paused_state, self._rest_left = "", 0.0
        self._last_activity = clock()  # time of the last recorded activity
        self.state = "pause"
        self._continue()
        self.apply_stop()

    @property
    def prompt(self) -> Prompt | None:
        """Current or next prompt."""
        return self.session.prompt

    @property
    def question(self) -> Question | None:
        """Current question."""
        return self.session.question if self.state == "question" else None

    @property
    def rest_left(self) -> float:
        """Remaining time of a pause or break [s]."""
        if self.state == "paused":
            return self._rest_left
        return max(0.0, self._break_end - self._clock()) if self.state in ("pause", "break") else 0.0

    def tick(self) -> None:
        """Advance the state: breaks end, time limits expire, trips of the device are stored."""
        now = self._clock()
        passed, self._last_tick = now - self._last_tick, now
        self.apply_stop()
        self._notice_off()
        self.session.store_late_events()
        rested = self.state in ("pause", "break") and now >= self._break_end
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
        if self.state in _RECORDED_STATES:
            self._last_activity = now
        self.trial_device.record(now - self._last_activity < _RECORDING_TAIL_S)

    def apply_stop(self) -> None:
        """Enter "paused" if Stop was given, and store its cause; the coils are off already."""
        if self.halt.active and self.state not in ("paused", *OVER):
            self._rest_left = self.rest_left
            if self.state in _IN_TRIAL:
                self._restart_reason = f"stopped {self.halt.why}".rstrip()
                self.state = "device off"
            self._paused_state, self.state = self.state, "paused"
        for stopped in self.halt.pop_unrecorded():
            self._record_event("pause", stopped.why, stopped.at)

    def answer(self, value: int | float | None) -> None:
        """Store the answer, durably, and continue. An invalid answer raises InputError; the trial continues."""
        self.apply_stop()
        self._notice_off()
        if self.state == "device off":
            raise InputError(
                "the device is off, so this answer does not count: please wait; the trial starts again when it is on"
            )
        prompt = self.prompt
        if self.state not in _IN_TRIAL or prompt is None:
            raise InputError(f"no answer is expected now ({self.state})")
        if value is None and prompt.wants_number:
            raise InputError("choose the number first, then answer")
        self._check_felt(prompt)
        number = self.session.number
        answer = Answer(value, self.trial_device.position, self.seconds)
        self.session.answer(
            answer,
            safety=self._trial_trips,
            recording=self.trial_device.course(self._recording),
            driver=self.trial_device.servo.driver,
        )
        self._mark("answer", {"trial": number + 1, "answer": value, "set_point": prompt.set_point})
        self.repeats, self._restart_reason, self._trial_trips = 0, "", []
        self._continue()

    def reply(self, text: str) -> None:
        """Store the reply to the current question."""
        self.apply_stop()
        question = self.question
        if question is None:
            raise InputError("no question is asked now")
        self.session.reply(question, text)
        self._mark("reply", {"question": question.name})
        self._continue()

    def skip(self) -> None:
        """End a break early; the pause between trials cannot be skipped."""
        self.apply_stop()
        if self.state == "break":
            self._begin()

    def interval(self, which: int | None) -> None:
        """Render interval `which`, 1 or 2."""
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
        """Switch the coils off until `resume`; a break is suspended meanwhile."""
        if self.state not in OVER:
            if not self.halt.active:
                self.halt.stop(why)  # safety: study-pause
            self.apply_stop()

    def resume(self, asked: StopCount | None = None) -> None:
        """Resume from a pause, restarting a trial; the coils ramp up from zero.

        InputError, and nothing changes, if Stop was given after `asked`; None: requested now.
        """
        self.apply_stop()
        if self.state != "paused":
            return
        self.halt.engage(asked or self.halt.read_count())
        self.state = self._paused_state
        self._break_end = self._clock() + self._rest_left
        self._last_tick = self._clock()
        self._record_event("resume")

    def repeat(self) -> None:
        """Restart the trial with its full time limit; the repetition is stored."""
        self.apply_stop()
        if self.state not in _IN_TRIAL or self.prompt is None:
            raise InputError(f"there is no trial to repeat now ({self.state})")
        self._restart_reason = "by the experimenter"
        self._begin()

    def engage(self, asked: StopCount | None = None) -> None:
        """Switch the coils on after a trip, unless the guard refuses, or Stop was given after `asked`; None: now."""
        self.apply_stop()
        if self.state == "paused":
            raise InputError("the session is paused: resume switches the coils on")
        self.halt.engage(asked or self.halt.read_count())

    def leave(self) -> None:
        """Leave the session, which can be resumed at this trial. Coils off first."""
        if self.state not in OVER:
            self._switch_off()
            self._record_event("leave")
            self.state = "left"

    def abort(self, why: str = "") -> None:
        """Abort the session. Coils off first, even if the end cannot be stored."""
        if self.state not in OVER:
            self._switch_off()
            self.session.abort(why)
            self._mark("abort", {"trial": self.session.number + 1})
            self.state = "aborted"

    def _switch_off(self) -> None:
        """Coils off, because the session ends."""
        # Of a Stop in force, no second: a new one would stop the session that somebody has asked for since, too.
        if not self.halt.active:
            self.halt.stop(None)
        self.apply_stop()

    def _continue(self) -> None:
        """State after an answer: question, break, trial or end."""
        self.trial_device.rest()
        prompt = self.prompt
        if self.session.question is not None:
            self.state = "question"
        elif prompt is None:
            self.state = "done"
            self._mark("done", {})
        else:
            wait = prompt.pause or (self.session.study.trials.pause_seconds if self.session.number else 0.0)
            self._break_end = self._clock() + wait
            self._last_activity = self._clock()
            self.state = "break" if prompt.pause else "pause"
            if prompt.pause:
                self._mark("break", {"seconds": wait})
            if not wait:
                self._begin()

    def _begin(self) -> None:
        """Start the trial, or wait until the device is on."""
        prompt = self.prompt
        assert prompt is not None
        self._record_trips()
        if self.trial_device.switched_off:
            self._wait_for_device()
            return
        self.state, self.which, self.seconds = "running", 1, 0.0
        self._felt_intervals.clear()
        self._last_tick = self._last_activity = self._clock()
        self.trial_device.record(True)
        self.trial_device.begin(prompt)
        if self._restart_reason:
            self.repeats += 1
            self._record_event("repeat", self._restart_reason)
            self._restart_reason = ""
        self._mark(
            "trial",
            {"trial": self.session.number + 1, "set_point": prompt.set_point, "condition": prompt.condition,
             "level": prompt.level, "interval": prompt.interval, "phase": prompt.phase},
        )  # fmt: skip

    def _notice_felt(self) -> None:
        if self.which not in self._felt_intervals and self.trial_device.is_felt():
            self._felt_intervals.add(self.which)

    def _check_felt(self, prompt: Prompt) -> None:
        """InputError if the stimulus has not been felt; after the time limit the trial restarts."""
        if self.state == "running":
            self._notice_felt()
        wanted = (
            {1, 2} if prompt.interval else {1} if self.session.study.procedure in ("rating", "magnitude") else set()
        )
        missing = sorted(wanted - self._felt_intervals)
        if not missing:
            return
        what = f"interval {missing[0]}" if prompt.interval else "this"
        if self.state == "time is up":
            self._restart_reason = f"answered before {what} was felt"
            self._begin()
            raise InputError(f"{what} was not felt before the time was up: not stored. The trial starts again")
        raise InputError(f"{what} has not been felt yet: not stored. Move the tool to feel it, then answer")

    def _wait_for_device(self) -> None:
        self.trial_device.rest()
        self.state = "device off"
        self._mark("device off", {"trial": self.session.number + 1})

    def _notice_off(self) -> None:
        """Store new trips; a trial in which the device was off restarts once it is on."""
        fresh = [str(trip["code"]) for trip in self._record_trips() if trip["code"] != "NOT_WATCHED"]
        if self.state in _IN_TRIAL and (fresh or self.trial_device.switched_off):  # safety: study-answer-off
            self._restart_reason = f"the device was off: {', '.join(fresh)}" if fresh else "the device was off"
            self._wait_for_device()

    def _record_trips(self) -> list[dict[str, Any]]:
        """Store and return new trips; those within a trial are also stored with its answer."""
        self.trial_device.poll_trips()
        fresh = self.trial_device.trips[self._trip_count :]
        self._trip_count += len(fresh)
        for trip in fresh:
            if trip["code"] == "STOPPED":  # stopped by a person: not a safety event
                continue
            if self.state in _IN_TRIAL:
                self._trial_trips.append(trip)
            known = {**trip, "trial": self.session.number}
            self.trips.append(known)
            self.session.record_event("safety", f"{trip['code']}: {trip['reason']}", later=True)
            self._mark("safety", {**known, "trial": self.session.number + 1})
        return fresh

    def _record_event(self, kind: str, text: str = "", at: str | None = None) -> None:
        self.session.record_event(kind, text, at=at, later=True)
        self._mark(kind, {"trial": self.session.number + 1} | ({"why": text} if text else {}))
