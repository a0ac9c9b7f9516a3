"""How strong the mover's magnets are: a relative error of all of them, of each, or by their temperature."""

from __future__ import annotations

from typing import Protocol, TypeVar

from haptorb.control.budget.current_errors import describe_share, find_origin
from haptorb.control.budget.error_model import ErrorSource
from haptorb.devices.device import Device
from haptorb.devices.uncertainty.common import ChainUncertainty
from haptorb.numerics.arrays import Array

__all__ = ["MagnetStrength", "MagnetTrial", "magnet_warmth"]


class MagnetTrial(Protocol):
    """A device with magnets in its mover."""

    def strengthen(self, factors: Array) -> None:
        """Multiply the strength of all magnets by `factors` (1,), or that of each by its own (p,)."""


M = TypeVar("M", bound=MagnetTrial)


class MagnetStrength(ErrorSource[M]):
    """The strength that all magnets share, or with several deviates that of each; `relative` standard uncertainty."""

    def __init__(self, name: str, relative: float, origin: str, magnets: int = 1, text: str = "") -> None:
        super().__init__(name, text or describe_share(relative), origin, magnets)
        self._relative = relative

    def perturb(self, deviates: Array, trial: M) -> None:
        """Change the strength of `trial` by the `deviates` (1,) [1]."""
        trial.strengthen(1 + self._relative * deviates)


def magnet_warmth(name: str, device: Device, known: ChainUncertainty) -> MagnetStrength[M]:
    """The temperature that all magnets of the mover share, in a hand and over warm coils."""
    kelvin = known.magnet_temperature
    origin = find_origin(device, known, "magnet_temperature")
    return MagnetStrength(name, kelvin * known.remanence_drift, origin, text=f"{kelvin:.3g} K")
