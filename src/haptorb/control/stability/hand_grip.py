"""Hands as the stability of a loop meets them: a mass on a spring and a damper, per axis.

What a hand is, is measured by pushing it: Hogan 1989 and Hajian and Howe 1997 report 0.1 to 0.8 kg, 2 to 10 N·s/m and
100 to 500 N/m, from a pen held lightly to one held firmly. A tool that is not held has hardly any damping.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from haptorb.errors import InputError, UnknownName

__all__ = ["GRIPS", "HandGrip", "check_grip"]


@dataclass(frozen=True)
class HandGrip:
    """One axis of a hand with what it holds: m ẍ + b ẋ + k x = force.

    >>> HandGrip(0.1, -1.0, 0.0)
    Traceback (most recent call last):
    haptorb.errors.InputError: a grip needs mass > 0 kg, damping ≥ 0 N·s/m and stiffness ≥ 0 N/m; got 0.1, -1, 0
    """

    mass: float  #: [kg]
    damping: float  #: [N·s/m]
    stiffness: float  #: [N/m]

    def __post_init__(self) -> None:
        values = (self.mass, self.damping, self.stiffness)
        if not (all(map(math.isfinite, values)) and self.mass > 0 and min(values) >= 0):
            raise InputError(
                "a grip needs mass > 0 kg, damping ≥ 0 N·s/m and stiffness ≥ 0 N/m; "
                f"got {', '.join(f'{value:g}' for value in values)}"
            )

    def with_mass(self, mass: float) -> HandGrip:
        """The same hand with an object of `mass` [kg] in it."""
        return HandGrip(self.mass + mass, self.damping, self.stiffness)


#: name → hand. `loose` is assumed: fingers that only guide, with the least damping that any hand is assumed to have
GRIPS = {
    "loose": HandGrip(0.1, 1.0, 20.0),
    "light": HandGrip(0.1, 2.0, 100.0),
    "firm": HandGrip(0.8, 10.0, 500.0),
}


def check_grip(text: str) -> HandGrip:
    """The grip called `text`, or the one that its three numbers MASS,DAMPING,STIFFNESS describe.

    Raises UnknownName for what is neither.

    >>> check_grip("firm").damping, check_grip("0.2,3,50").mass
    (10.0, 0.2)
    """
    if text in GRIPS:
        return GRIPS[text]
    try:
        mass, damping, stiffness = (float(part) for part in text.split(","))
    except ValueError:
        raise UnknownName("grip", text, (*GRIPS, "MASS,DAMPING,STIFFNESS")) from None
    return HandGrip(mass, damping, stiffness)
