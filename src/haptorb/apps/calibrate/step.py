"""A step of a guided calibration, as the dialog takes it: what it asks of the person, measures, and leaves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from haptorb.apps.calibrate.driver import Hand
from haptorb.apps.calibrate.heating import HEATING, HeatingSchedule
from haptorb.apps.calibrate.measure import DriverSession
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.numerics.arrays import Array

__all__ = ["EFFORT", "CalibrationEffort", "Results", "Step", "StepContext"]

Results = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class CalibrationEffort:
    """How much is measured: what a test does in seconds takes a real device minutes.

    levels, repeats  of the currents in the magnetic step
    drives           of every coil in the step `fields`
    course           of the heat step
    led              for so long the tool is led over the dome [s]
    """

    levels: int = 5
    repeats: int = 4
    drives: int = 10
    course: HeatingSchedule = HEATING
    led: float = 45.0


EFFORT = CalibrationEffort()


@dataclass(frozen=True)
class StepContext:
    """One device with its driver open: what a step may use.

    axes      (k, 3) directions of one-axis field sensors; None: three axes each
    schedule  (n, m) [A] of the magnetic step
    effort    of the other steps
    """

    device: SphericalElectromagnet
    session: DriverSession
    axes: Array | None
    schedule: Array
    effort: CalibrationEffort = EFFORT


class Step(ABC):
    """One measurement; `needs` are the steps before it."""

    name: str
    title: str
    asks: str  #: of the person, before it begins
    needs: tuple[str, ...] = ()
    hand: Hand = "away"  #: where the tool is: away, at the summit, or led over the dome

    @abstractmethod
    def seconds(self, bench: StepContext) -> float:
        """How long it takes, for a bar."""

    @abstractmethod
    def measure(self, bench: StepContext, before: Results) -> dict[str, Any]:
        """Do it; CalibrationError names what is not as it must be."""

    @abstractmethod
    def describe(self, device: SphericalElectromagnet, result: Mapping[str, Any]) -> str:
        """The result in one line."""
