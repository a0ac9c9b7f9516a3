"""What field sensors make of the field: gain, cross-axis, offset, noise and place, each sensor its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from haptorb.control.budget.current_errors import ChainTrial, describe_share
from haptorb.control.budget.error_model import ErrorSource
from haptorb.display.quantity_text import format_quantity
from haptorb.numerics.arrays import Array

__all__ = ["SensorMixing", "SensorPlacement", "SensorReading", "SensorTrial"]


@dataclass
class SensorTrial(ChainTrial):
    """How the field sensors of one device differ from ideal ones, and the electronics; zeros: not at all."""

    mixing: Array  #: (k, 3, 3) what they read of a field beyond the field itself, along their own axes
    reading: Array  #: (k, 3) what they read without a field [T]
    placement: Array  #: (k, 3) from the nominal places [m]

    def read_field(self, field: Array, frames: Array | None = None) -> Array:
        """(k, 3) readings [T] of a true `field` (k, 3) [T]; columns of frames (k, 3, 3) are the sensors' own axes."""
        own = field if frames is None else np.einsum("kji,kj->ki", frames, field)
        own = own + np.einsum("kij,kj->ki", self.mixing, own) + self.reading
        read: Array = own if frames is None else np.einsum("kij,kj->ki", frames, own)
        return read


S = TypeVar("S", bound=SensorTrial)


class SensorMixing(ErrorSource[S]):
    """Gain of each field sensor's axes, or what they read of each other."""

    def __init__(self, name: str, standard: float, origin: str, sensors: int, *, across: bool) -> None:
        super().__init__(name, describe_share(standard), origin, sensors * (6 if across else 3))
        self._standard, self._where = standard, np.nonzero(np.eye(3) != across)

    def perturb(self, deviates: Array, trial: S) -> None:
        """Change what the sensors read of a field."""
        rows, columns = self._where
        trial.mixing[:, rows, columns] += self._standard * deviates.reshape(len(trial.mixing), -1)


class SensorReading(ErrorSource[S]):
    """What each axis of the field sensors reads without a field: its offset, or its noise."""

    def __init__(self, name: str, standard: float, origin: str, sensors: int) -> None:
        super().__init__(name, format_quantity(standard, "T"), origin, 3 * sensors)
        self._standard = standard

    def perturb(self, deviates: Array, trial: S) -> None:
        """Add to the readings."""
        trial.reading += self._standard * deviates.reshape(-1, 3)


class SensorPlacement(ErrorSource[S]):
    """Where each field sensor is."""

    def __init__(self, standard: float, origin: str, sensors: int) -> None:
        super().__init__("field sensors, place", format_quantity(standard, "m"), origin, 3 * sensors)
        self._standard = standard

    def perturb(self, deviates: Array, trial: S) -> None:
        """Move the sensors."""
        trial.placement += self._standard * deviates.reshape(-1, 3)
