"""Results of a study's analysis, as data; `analysis.py` computes them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from haptorb.display import Presentable
from haptorb_study.analysis.comparison import ConditionComparison, RatingMean
from haptorb_study.analysis.condition_means import ConditionMean, list_condition_means
from haptorb_study.analysis.confusion import Arrow, Confusion
from haptorb_study.analysis.curves import ConditionCurves
from haptorb_study.analysis.error_by_latitude import LatitudeError
from haptorb_study.analysis.localisation import Localisation
from haptorb_study.analysis.magnitude import MagnitudeScale, list_magnitudes
from haptorb_study.analysis.plan_report import PlanReport
from haptorb_study.analysis.response_times import ResponseTime, list_response_times
from haptorb_study.analysis.tracks import ConditionTracks
from haptorb_study.incidents import Incident
from haptorb_study.json_values import json_number, to_json
from haptorb_study.study_file import Study

__all__ = ["StudyResults"]


@dataclass(frozen=True)
class StudyResults(Presentable):
    """All results of a study, as `Analysis` describes them; those that do not apply to its procedure are empty."""

    study: Study
    participants: int
    trials: int
    practice: int
    simulated: int
    trips: int
    repeated: int = 0
    on_simulated_device: int = 0
    on_unknown_device: int = 0
    confusion: Confusion | None = None
    arrows: tuple[Arrow, ...] = ()
    means: tuple[ConditionMean, ...] = ()
    rings: tuple[LatitudeError, ...] = ()
    curves: dict[str, ConditionCurves] = field(default_factory=dict)
    tracks: dict[str, ConditionTracks] = field(default_factory=dict)
    thresholds: dict[str, dict[str, float]] = field(default_factory=dict)
    scores: dict[str, RatingMean] = field(default_factory=dict)
    chosen: dict[tuple[str, str], tuple[int, int, tuple[float, float]]] = field(default_factory=dict)
    comparisons: tuple[ConditionComparison, ...] = ()
    localisation: Localisation | None = None
    plan: PlanReport | None = None
    magnitudes: tuple[MagnitudeScale, ...] = ()
    times: tuple[ResponseTime, ...] = ()
    notes: tuple[str, ...] = ()
    left_out: str = ""
    incidents: tuple[Incident, ...] = ()
    recorded: tuple[tuple[str, int, str, str], ...] = ()

    def _summarize(self) -> str:
        return f"<Analysis of study {self.study.name!r}: {self.trials} trials; {self.origin}>"

    @property
    def origin(self) -> str:
        """Participants and device behind the data, as printed on every page and figure; SIMULATED where they are."""
        people = f"{self.participants} participant{'' if self.participants == 1 else 's'}"
        if self.simulated == self.participants:
            return f"SIMULATED: {people.replace(' ', ' simulated ')}, calibrated to Zárate 2020; no person took part"
        text = people
        if self.simulated:
            text = f"PARTLY SIMULATED: {self.simulated} of {people} are simulated"
        if self.on_simulated_device:
            whole = not self.simulated and self.on_simulated_device == self.trials
            share = "" if whole else f" in {self.on_simulated_device} of {self.trials} trials"
            text = f"SIMULATED DEVICE{share}: nobody felt a force; {text}"
        if self.on_unknown_device:
            text = f"{text}; whether the device was simulated is not stored for {self.on_unknown_device} trials"
        return text

    @property
    def marked(self) -> bool:
        """Whether any participant or the device was simulated."""
        return self.simulated > 0 or self.on_simulated_device > 0

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types; NaN and infinity become None."""
        found: dict[str, Any] = {
            "study": self.study.name, "procedure": self.study.procedure, "origin": self.origin,
            "participants": self.participants, "simulated": self.simulated, "trials": self.trials,
            "practice_trials": self.practice, "trials_with_trips": self.trips, "repeated_trials": self.repeated,
            "trials_on_simulated_device": self.on_simulated_device, "trials_on_unknown_device": self.on_unknown_device,
        }  # fmt: skip
        if (c := self.confusion) is not None:
            found["accuracy"] = {
                "mean": c.accuracy, "interval_95": [json_number(x) for x in c.accuracy_95],
                "single_participant_95": [json_number(x) for x in c.single_95],
                "chance": c.chance, "p_by_chance": c.p_chance,
                "by_set_point": {str(n): json_number(c.matrix[i, i]) for i, n in enumerate(c.numbers)},
                "by_set_point_95": {
                    str(n): [json_number(x) for x in c.right_95[i]] for i, n in enumerate(c.numbers)
                },
            }  # fmt: skip
            found["confusion"] = [[json_number(x) for x in row] for row in c.matrix.tolist()]
            found["arrows"] = [vars(arrow) for arrow in self.arrows]
        if self.means:
            found["condition_means"] = list_condition_means(self.means)
        if self.rings:
            found["error_mm"] = [to_json(vars(ring)) for ring in self.rings]
        if self.curves:
            found["curves"] = {name: one.numbers() for name, one in self.curves.items()}
        if self.curves or self.tracks or self.magnitudes:
            levels = self.study.levels
            found["level"] = {"parameter": levels and levels.parameter, "unit": self.study.level_unit or "1"}
        if self.tracks:
            found["thresholds"] = {name: one.numbers() for name, one in self.tracks.items()}
        if self.scores:
            found["ratings"] = {name: to_json(vars(one)) for name, one in self.scores.items()}
        if self.chosen:
            found["choices"] = [
                {"a": a, "b": b, "a_chosen": k, "of": n, "interval_95": list(w)}
                for (a, b), (k, n, w) in self.chosen.items()
            ]
        if self.magnitudes:
            found["magnitudes"] = list_magnitudes(self.magnitudes)
        if self.times:
            found["response_times"] = list_response_times(self.times)
        if self.comparisons:
            found["comparisons"] = [one.numbers() for one in self.comparisons]
        if self.localisation is not None:
            found["localisation"] = self.localisation.numbers()
        if self.plan is not None:
            found["plan"] = self.plan.numbers()
        found["left_out"] = self.left_out
        found["incidents"] = [one.row() for one in self.incidents]
        if self.notes:
            found["notes"] = list(self.notes)
        return found
