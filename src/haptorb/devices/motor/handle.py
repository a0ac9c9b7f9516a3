"""What surrounds a motor's rotor: the hand on its handle, and the stop at its edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptorb.errors import InputError

__all__ = ["HANDLE_LOOSE", "EndStop", "Grasp"]


@dataclass(frozen=True)
class Grasp:
    """A hand on the handle as mass, spring and damper where it holds, towards where it wants the handle to be.

    One stiffness for tilt and spin, so that the spring has a potential. From a pen held lightly (0.1 kg, 2 N·s/m,
    100 N/m) to a firm grip (0.8 kg, 10 N·s/m, 500 N/m).
    """

    mass: float  #: that moves with the handle [kg]
    stiffness: float  #: [N/m]
    damping: float  #: [N·s/m]
    radius: float  #: of the fist: its inertia about the handle is ½ m r² [m]

    def __post_init__(self) -> None:
        for name in ("mass", "stiffness", "damping", "radius"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"Grasp.{name} must not be negative; got {value!r}")


HANDLE_LOOSE = Grasp(0.0, 0.0, 0.0, 0.0)  #: no hand at all


@dataclass(frozen=True)
class EndStop:
    """Rubber at the edge of the workspace."""

    stiffness: float  #: [N·m/rad]
    damping: float  #: [N·m·s/rad]
