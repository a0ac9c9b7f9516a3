"""One simulated participant who sits the whole study in memory, and what the measures make of the answers."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from haptorb.apps.asking.procedure import Procedure
from haptorb.apps.asking.prompt import Answer, Prompt
from haptorb.apps.study.analysis.over_people.measures import PersonMeasures, list_thresholds
from haptorb.apps.study.model.order import plan, procedure_of
from haptorb.apps.study.model.study_file import Study
from haptorb.apps.study.simulated.participant import Participant
from haptorb.apps.study.store.columns import Columns, place_answers

__all__ = ["ADAPTIVE", "answer_study", "list_columns", "simulate_value"]

ADAPTIVE = ("staircase", "bayesian")  #: procedures whose thresholds are their own
_CODE = "SIM"


def simulate_value(
    study: Study, seed: tuple[int, ...], ordinal: int, measure: str, between: tuple[str, str] | None
) -> float:
    """a − b of one simulated participant, the `ordinal`-th, or the measure itself; NaN where something is missing.

    `seed` decides everything that is drawn, so it matters neither where nor in which order participants are simulated.
    """
    procedure, responses = answer_study(study, seed, ordinal)
    main = list_columns(study, responses)
    thresholds = list_thresholds({_CODE: procedure}) if study.procedure in ADAPTIVE else None
    found = PersonMeasures(study, main, [_CODE], thresholds).compare(measure, between).differences
    return float(found[0]) if len(found) else float("nan")


def answer_study(study: Study, seed: tuple[int, ...], ordinal: int) -> tuple[Procedure, list[tuple[Prompt, Answer]]]:
    """The procedure after all trials of one simulated participant, and what was asked and answered in turn."""
    somebody = Participant(study, seed)
    procedure: Procedure = procedure_of(study, plan(study, ordinal))
    responses: list[tuple[Prompt, Answer]] = []
    while (prompt := procedure.prompt) is not None:
        answer = somebody.answer(prompt, len(responses))
        procedure = procedure.record_answer(answer)
        responses.append((prompt, answer))
    return procedure, responses


def list_columns(study: Study, responses: Iterable[tuple[Prompt, Answer]], code: str = _CODE) -> Columns:
    """What measures read of the tidy table, for the participant `code`; without practice, as in every analysis."""
    main = [(prompt, answer) for prompt, answer in responses if prompt.phase != "practice"]
    points = {point.number: point for point in study.points}
    ways = np.array([points[p.set_point].direction if p.set_point else (np.nan,) * 3 for p, _ in main]).reshape(-1, 3)
    place = np.array([a.position or (np.nan,) * 3 for _, a in main], dtype=float).reshape(-1, 3)
    number = np.array([p.set_point for p, _ in main])
    contact = study.load_device().contact_distance
    answer = np.array([np.nan if a.value is None else a.value for _, a in main], dtype=float)
    return {
        "participant": np.full(len(main), code), "set_point": number, "answer": answer,
        "condition": np.array([p.condition for p, _ in main]), "other": np.array([p.other for p, _ in main]),
        "level": np.array([p.level for p, _ in main]), "interval": np.array([p.interval for p, _ in main]),
        "theta_deg": np.array([points[p.set_point].theta_deg if p.set_point else np.nan for p, _ in main]),
        "correct": np.where(np.isfinite(answer), answer == number, np.nan),
        "x_m": place[:, 0], "y_m": place[:, 1], "z_m": place[:, 2],
        "distance_mm": 1e3 * np.linalg.norm(place_answers(study, answer, place) - contact * ways, axis=1),
    }  # fmt: skip
