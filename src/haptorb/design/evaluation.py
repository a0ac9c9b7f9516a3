"""The evaluation of one candidate: its numbers, or why it was refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["Evaluation", "Value"]

Value = float | str  #: of a parameter, in the parameter's own unit; a choice by its label


@dataclass(frozen=True)
class Evaluation:
    """One row of a results file.

    number       place in the run, from 0: the same seed gives the same values for the same number
    values       parameter → value
    objectives   objective → number in its unit; empty if refused
    constraints  constraint → number in its unit, as far as they were computed
    refused_by   name of the constraint that refused it, "device" if the values make none, "objective" if one gave no
                 finite number; empty if it is valid
    reason       one line: why it was refused; empty if it is valid
    seconds      processor time [s]
    """

    number: int
    values: Mapping[str, Value]
    objectives: Mapping[str, float]
    constraints: Mapping[str, float]
    refused_by: str = ""
    reason: str = ""
    seconds: float = 0.0

    @property
    def valid(self) -> bool:
        """Whether it is a design that keeps every constraint."""
        return not self.refused_by
