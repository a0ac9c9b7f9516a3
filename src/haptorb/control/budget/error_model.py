"""What an error budget needs of a device: sources of error, places and wrenches, and the error of one trial.

A trial is one device as it could be, at one place. Every source draws from the standard normal distribution and changes
the trial by its standard uncertainty times what was drawn. So a new source is one small class.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from haptorb.numerics.arrays import Array

__all__ = ["Component", "ErrorModel", "ErrorSource", "P", "T"]

T = TypeVar("T")  #: what a source changes: a device as it could be
P = TypeVar("P")  #: where the mover is and what is asked there


class ErrorSource(ABC, Generic[T]):
    """One reason why the delivered wrench is not the one asked for.

    name       short, as tables and JSON have it
    standard   its standard uncertainty with unit, as text
    origin     where that comes from: "device file", "assumed", "default", "calibration"
    dimension  number of independent standard normal deviates that it takes
    """

    def __init__(self, name: str, standard: str, origin: str, dimension: int) -> None:
        self.name, self.standard, self.origin, self.dimension = name, standard, origin, dimension

    @abstractmethod
    def perturb(self, deviates: Array, trial: T) -> None:
        """Change `trial` by standard normal `deviates` (dimension,) [1] times the standard uncertainty."""


@dataclass(frozen=True)
class Component:
    """One component of the error as tables have it; several axes that are alike are taken together."""

    name: str
    axes: tuple[int, ...]


class ErrorModel(ABC, Generic[T, P]):
    """A device, its sources of error, and the chain from the wrench asked for to the wrench delivered.

    device      its name
    estimator   how the controller knows where the mover is
    sources     of error, independent of each other
    regions     names of the parts of the workspace, each with its own budget
    components  of the error
    unit        "N" or "N·m"
    jnd         just-noticeable difference, relative
    asked       magnitude of the wrench asked for [N or N·m]; its direction is drawn from all directions
    motion      how it changes, in words
    """

    device: str
    estimator: str
    sources: tuple[ErrorSource[T], ...]
    regions: tuple[str, ...]
    components: tuple[Component, ...]
    unit: str
    jnd: float
    asked: float
    motion: str

    @abstractmethod
    def draw_point(self, region: int, rng: np.random.Generator) -> P:
        """A place in that region and a wrench to ask for there."""

    @abstractmethod
    def make_trial(self) -> T:
        """The device of the model."""

    @abstractmethod
    def wrench_error(self, point: P, trial: T) -> Array:
        """(3,) what `trial` delivers at `point` less what is asked [N or N·m], along the axes of `components`."""

    @property
    def dimension(self) -> int:
        """Number of deviates of all sources."""
        return sum(source.dimension for source in self.sources)

    def try_error(self, point: P, deviates: Array, only: int | None = None) -> Array:
        """(3,) the error with `deviates` (dimension,), or with those of source number `only` alone [N or N·m]."""
        trial, first = self.make_trial(), 0
        for number, source in enumerate(self.sources):
            last = first + source.dimension
            if only is None or only == number:
                source.perturb(deviates[first:last], trial)
            first = last
        return self.wrench_error(point, trial)
