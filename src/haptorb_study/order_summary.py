"""Realised order of a study before its first session: sequence per participant, balance, breaks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from haptorb.errors import InputError
from haptorb_study.order import list_units, plan, procedure_of, square_size
from haptorb_study.procedures import InterleavedProcedures
from haptorb_study.prompts import Prompt
from haptorb_study.study_file import Study
from haptorb_study.trial_lists import has_set_points

__all__ = ["OrderSummary", "summarize_order"]


_MAX_PRINTED_PARTICIPANTS = 1000  #: participants whose order can be printed


@dataclass(frozen=True)
class OrderSummary:
    """Order of the first participants; `plans` are their session plans as they will be stored."""

    rule: str
    units: tuple[str, ...]  #: conditions, or pairs of a forced choice
    side_by_side: bool  #: whether tracks are interleaved in rounds instead of blocks
    square: int  #: participants of a complete counterbalanced order
    plans: tuple[dict[str, Any], ...]
    sequences: tuple[tuple[str, ...], ...]  #: per participant: units of the main trials
    asked: tuple[tuple[str, ...], ...]  #: per participant: set-point, level or interval of these trials
    asks: str  #: which of these
    trials: int  #: main trials; adaptive: at most
    practice: int
    breaks: int
    break_seconds: float
    adaptive: bool  #: whether the number of trials depends on the answers

    @property
    def mixed(self) -> bool:
        """Whether trials of different units are mixed."""
        return len(self.units) > 1 and (self.side_by_side or self.rule == "random")

    @property
    def sentences(self) -> list[str]:
        """Summary for users, one sentence each."""
        most = "at most " if self.adaptive else ""
        rest = f"{self.breaks} break{'' if self.breaks == 1 else 's'} of {self.break_seconds:g} s"
        found = [
            f"{most}{self.trials} trials after {self.practice} practice trials, {most}{rest}"
            if self.breaks
            else f"{most}{self.trials} trials after {self.practice} practice trials, no breaks"
        ]
        if len(self.units) < 2:
            return [*found, "order: random, each participant's own"]
        what, unit = "first round" if self.side_by_side else "order", "pair" if ", " in self.units[0] else "condition"
        if self.rule == "counter-balanced":
            found.append(
                f"order: counter-balanced; every {self.square} participants complete a Williams square: in the {what} "
                f"every {unit} is in every position, and follows every other one, equally often"
            )
        elif self.rule == "random":
            found.append("order: random; all trials mixed" if not self.side_by_side else "order: random rounds")
        else:
            found.append(
                "order: blocked, the same for all participants: an effect of order cannot be distinguished from "
                "one of the conditions"
            )
        if self.side_by_side:
            found.append(f"rounds: each contains every {unit} once; those that have ended are skipped")
        return found

    def row(self, person: int) -> str:
        """Order of a participant as text: the first trials, per block if blocked."""
        names, asked = self.sequences[person], self.asked[person]
        if len(self.units) < 2:
            return _begin(asked, 24)
        if self.mixed:
            return _begin(names, 12)
        blocks = [[text for _, text in block] for _, block in groupby(zip(names, asked, strict=True), lambda x: x[0])]
        heads = [name for name, _ in groupby(names)]
        return "; ".join(f"{name}: {_begin(block, 6)}" for name, block in zip(heads, blocks, strict=True))

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {
            "rule": self.rule, "units": list(self.units), "side_by_side": self.side_by_side,
            "participants_for_balance": self.square, "trials": self.trials, "trials_are_a_maximum": self.adaptive,
            "practice_trials": self.practice, "breaks": self.breaks, "break_s": self.break_seconds,
            "sessions": list(self.plans),
        }  # fmt: skip


#: procedure → what varies between its trials
_VARIED = {
    "identification": "set-points", "localisation": "set-points", "constant": "levels", "magnitude": "levels",
    "staircase": "intervals with the comparison", "bayesian": "intervals with the comparison",
    "forced-choice": "intervals with the first of the pair",
}  # fmt: skip


def _label_trial(study: Study, prompt: Prompt) -> str:
    """Short label of a listed trial: set-point, level or interval."""
    if study.procedure in ("constant", "magnitude"):
        return f"{prompt.level:g}"
    return str(prompt.set_point if has_set_points(study) else prompt.interval or "–")


def _begin(texts: Sequence[str], count: int) -> str:
    return " ".join(texts[:count]) + (" ..." if len(texts) > count else "")


def summarize_order(study: Study, people: int = 6) -> OrderSummary:
    """Order for the first `people` participants, exactly as it will be stored when each begins."""
    if not 1 <= people <= _MAX_PRINTED_PARTICIPANTS:
        raise InputError(f"the order can be shown for 1 to {_MAX_PRINTED_PARTICIPANTS} participants; got {people}")
    plans = tuple(plan(study, n) for n in range(people))
    units = list_units(study)
    sequences, asked, pauses, practice = [], [], 0, 0
    for one in plans:
        procedure = procedure_of(study, one)
        names, texts, pauses, practice = [], [], 0, 0
        if isinstance(procedure, InterleavedProcedures):
            tracks = [str(part.get("condition", "")) for part in one["parts"]]
            names = [tracks[turn] for turn in procedure.turns if tracks[turn]]
            intervals = [iter(part.get("intervals", ())) for part in one["parts"]]
            texts = [str(next(intervals[turn])) for turn in procedure.turns if tracks[turn]]
            practice, pauses = len(procedure.turns) - len(names), len(procedure.pauses)
        else:
            for part in one["parts"]:
                for prompt in map(Prompt.read, part.get("prompts", ())):
                    practice += prompt.phase == "practice"
                    pauses += prompt.pause > 0
                    if prompt.phase != "practice":
                        names.append(f"{prompt.condition}, {prompt.other}" if prompt.other else prompt.condition)
                        texts.append(_label_trial(study, prompt))
                names += [str(part.get("condition", ""))] * len(part.get("intervals", ()))
                texts += map(str, part.get("intervals", ()))
        sequences.append(tuple(names))
        asked.append(tuple(texts))
    side = study.procedure in ("staircase", "bayesian", "forced-choice") and study.trials.order != "blocked"
    square = square_size(len(units)) if study.trials.order == "counter-balanced" else 1
    return OrderSummary(
        study.trials.order, tuple(units), side and bool(study.order_version), square, plans, tuple(sequences),
        tuple(asked), _VARIED.get(study.procedure, ""), len(sequences[0]), practice, pauses, study.trials.break_seconds,
        study.procedure in ("staircase", "bayesian"),
    )  # fmt: skip
