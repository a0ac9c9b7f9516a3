"""Directions of prompted and answered places, seen from the centre of the dome."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Array
from haptorb_study.columns import Columns
from haptorb_study.set_points import directions
from haptorb_study.study_file import Study

__all__ = ["SPHERICAL", "answer_directions", "answer_numbers", "find_unbounded", "index_set_points"]


SPHERICAL = ("identification", "localisation")  #: procedures whose answers are places on the dome


def answer_directions(study: Study, main: Columns, rows: Any) -> tuple[Array, Array]:
    """(prompted, answered): (rows, 3) unit vectors of the trials `rows` (index); NaN where an answer has no direction.

    The answer of an identification is the set-point named, that of a localisation the place reached.
    """
    ways = directions(study.points)
    asked = ways[index_set_points(study, main["set_point"][rows])]
    if study.procedure == "identification":
        return asked, ways[index_set_points(study, main["answer"][rows])]
    place = np.stack([main[f"{axis}_m"][rows] for axis in "xyz"], axis=-1).astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        return asked, place / np.linalg.norm(place, axis=-1, keepdims=True)


def answer_numbers(study: Study, main: Columns) -> NDArray[Any]:
    """(trials,) number of the set-point answered, or of the one nearest to the place reached."""
    if study.procedure == "identification":
        return main["answer"]
    ways = directions(study.points)
    place = np.stack([main[f"{axis}_m"] for axis in "xyz"], axis=-1).astype(float)
    numbers = np.array([point.number for point in study.points])
    found: NDArray[Any] = numbers[np.argmax(np.nan_to_num(place) @ ways.T, axis=-1)]
    return found


def find_unbounded(study: Study, main: Columns, rows: Any) -> NDArray[np.bool_]:
    """(rows,) whether an answer can deviate both upwards and downwards; not at the top, which has no meridian.

    In an identification no answer lies below the outermost ring of set-points.
    """
    theta = main["theta_deg"][rows]
    known: NDArray[np.bool_] = (theta > 1e-9) & (theta < 180 - 1e-9)
    if study.procedure == "identification":
        known &= theta < max(point.theta_deg for point in study.points) - 1e-9
    return known


def index_set_points(study: Study, numbers: NDArray[Any]) -> NDArray[np.intp]:
    """(n,) indices of the set-points with these `numbers` in the study's list."""
    known = np.array([point.number for point in study.points])
    order = np.argsort(known)
    found: NDArray[np.intp] = order[np.searchsorted(known[order], numbers.astype(int))]
    return found
