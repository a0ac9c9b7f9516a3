"""Error of the answers by the polar angle θ of the set-point."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from haptorb_study.columns import Columns
from haptorb_study.statistics.intervals import mean_interval

__all__ = ["ERROR_MEANING", "LatitudeError", "measure_rings", "measure_tool_rings", "name_error"]


#: procedure → definition of its error, printed below its tables
ERROR_MEANING = {
    "identification": "Error: straight distance between the contact positions of the set-point named and the set-point "
    "shown; 0 for every right answer, wherever the tool was.",
    "localisation": "Error: straight distance of the tool's magnet at the answer from its contact position at the "
    "set-point.",
}


def name_error(procedure: str) -> str:
    """Short definition of the error of `procedure`, for a title."""
    return {
        "identification": "from the set-point shown to the one named", "localisation": "from the set-point to the tool",
    }.get(procedure, "")  # fmt: skip


@dataclass(frozen=True)
class LatitudeError:
    """Error at the set-points of one θ."""

    theta_deg: float
    trials: int
    mean: float  #: [mm] mean of the participants' means
    sd: float  #: [mm] over trials
    low: float  #: [mm] confidence limits of the mean over participants
    high: float  #: [mm]


def measure_rings(main: Columns, index: np.ndarray[Any, Any], people: int) -> tuple[LatitudeError, ...]:
    """Error by θ; `index` (trials,) is the participant of each trial, of `people` participants."""
    found = []
    for theta in np.unique(main["theta_deg"][np.isfinite(main["theta_deg"])]):
        here = (main["theta_deg"] == theta) & np.isfinite(main["distance_mm"])
        if not here.any():
            continue
        error = main["distance_mm"][here]
        counts = np.bincount(index[here], minlength=people)
        with np.errstate(invalid="ignore", divide="ignore"):
            own = np.bincount(index[here], error, people) / counts
        low, high = mean_interval(own)
        sd = float(error.std(ddof=1)) if len(error) > 1 else math.nan
        found.append(
            LatitudeError(float(theta), len(error), float(own[counts > 0].mean()), sd, float(low), float(high))
        )
    return tuple(found)


def measure_tool_rings(columns: Columns) -> tuple[LatitudeError, ...]:
    """Distance of the tool at the answer from the set-point shown, by θ, whatever place was named: the error that
    Zárate 2020 prints in Fig. 9."""
    here = columns["phase"] == "main"
    main = {name: values[here] for name, values in columns.items()}
    people, index = np.unique(main["participant"], return_inverse=True)
    return measure_rings({**main, "distance_mm": main["pen_distance_mm"]}, index, len(people))
