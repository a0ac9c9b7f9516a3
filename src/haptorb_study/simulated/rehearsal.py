"""Rehearsal of a study: simulated participants, marked as such, in the same database with the same procedures."""

from __future__ import annotations

from collections.abc import Callable

from sqlalchemy.engine import Engine

from haptorb.errors import InputError
from haptorb_study.simulated.participant import Participant, Traits
from haptorb_study.stored_session import StoredSession
from haptorb_study.study_file import Study

__all__ = ["answer_rest", "rehearse"]


def rehearse(
    engine: Engine,
    study: Study,
    people: int = 6,
    *,
    seed: int = 0,
    first: int = 1,
    traits: Traits | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Run the study with simulated participants SIM01, SIM02 ... (from `first`); returns the number of trials answered.

    `progress` receives (trials done, trials in all at most). A rehearsal that was interrupted is resumed.
    """
    if not 1 <= people <= 10_000 or seed < 0 or first < 1:
        raise InputError(f"people must be 1 to 10000, seed 0 or more, first 1 or more; got {people}, {seed}, {first}")
    answered = 0
    for n in range(first, first + people):
        with StoredSession(engine, study, f"SIM{n:02d}", simulated=True) as session:
            done, left = answered, session.procedure.expected

            def report_trials(k: int, done: int = done, left: int = left) -> None:
                if progress is not None:
                    progress(done + k, people * left)

            answered += answer_rest(session, Participant(study, (seed, n), traits), report_trials)
    return answered


def answer_rest(session: StoredSession, participant: Participant, progress: Callable[[int], None] | None = None) -> int:
    """Answer the remaining trials of `session`; returns their number."""
    answered = 0
    while (prompt := session.prompt) is not None:
        session.answer(participant.answer(prompt, session.number), driver="sim")
        answered += 1
        if progress is not None:
            progress(answered)
    return answered
