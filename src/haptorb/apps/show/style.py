"""Colours of a drawing, distinguished with any colour vision, and the scale bar."""

from __future__ import annotations

__all__ = ["BODY", "CORE", "LABELS", "NORTH", "REACH", "SENSOR", "SOUTH", "choose_bar"]

#: Okabe and Ito's
NORTH, SOUTH, SENSOR, REACH = "#d55e00", "#0072b2", "#009e73", "#56b4e9"
CORE = "#9aa0a6"
BODY = {"coil": "#e0a040", "magnet": "#c0c6cc", "ring": "#c0c6cc"}
LABELS = {"coil": "coil (winding)", "magnet": "magnet", "ring": "magnet ring"}


def choose_bar(size: float) -> float:
    """Length of a scale bar [m], a round number, for a picture of a device of `size` [m].

    >>> choose_bar(0.07), choose_bar(0.14)
    (0.02, 0.05)
    """
    power = 10.0**-6
    best = power
    while power < 1e3:
        for step in (1.0, 2.0, 5.0):
            if step * power <= 0.4 * size:
                best = step * power
        power *= 10.0
    return round(best, 12)
