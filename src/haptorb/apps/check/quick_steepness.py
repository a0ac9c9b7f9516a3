"""How steep a world with memory is to a small quick motion: bristles bend, a ball stays where it is.

Looked at from its beginning such a world may have no slope at all. So it is held at a place until it has settled, and
then moved a little from there, again and again with the same memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from haptorb.apps.check.workspace import Workspace
from haptorb.control.stability.gradient import Steepness
from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.worlds.bound_world import BoundWorld
from haptorb.worlds.dynamic_world import DynamicWorld
from haptorb.worlds.world import World

__all__ = ["list_quick_steepness"]

_PLACES = 120  #: of the workspace, from its first on: they are in no order
_HOLD = 5  #: ticks at a place before it is moved
_STEP = 2e-5  #: of the differences [m] or [rad]


@final
@dataclass(frozen=True)
class _SettledWorld(World):
    """A world with memory that is moved from where it was held; `Workspace.field` takes it for a world without."""

    bound_world: BoundWorld | None = None

    def hold(self, state: State) -> None:
        """Begin, and stay at `state` for a while."""
        assert self.bound_world is not None
        self.bound_world.restart()
        for _ in range(_HOLD):
            self.bound_world.wrench(state)

    def wrench(self, state: State) -> Array:
        """(6,) at `state` [N, N·m], one tick after the place where it is held now; that memory comes back."""
        assert self.bound_world is not None
        before = self.bound_world.numbers.copy()
        try:
            self.bound_world.wrench(state)
            return self.bound_world.wrench(state).copy()
        finally:
            self.bound_world.numbers[:] = before


class _Holder:
    """Stands for the world when `Workspace.field` asks at a place: hold it there."""

    def __init__(self, settled: _SettledWorld) -> None:
        self._settled = settled

    def for_device(self, device: Device) -> _Holder:
        return self

    def wrench(self, state: State) -> Array:
        self._settled.hold(state)
        return np.zeros(6)


def list_quick_steepness(device: Device, world: DynamicWorld, place: Workspace, dt: float) -> list[Steepness]:
    """The principal stiffnesses of `world` at places all over the workspace of `device`, against a motion within one
    tick of `dt` [s]; in the workspace's own coordinates, as `steepest` has them."""
    fitted = world.for_device(device)
    assert isinstance(fitted, DynamicWorld)
    settled = _SettledWorld(BoundWorld(fitted, dt))
    hold, field = place.field(_Holder(settled)), place.field(settled)  # type: ignore[arg-type]
    still, found = np.zeros(3), []
    for p in place.places[:_PLACES]:
        hold(p, still, 0.0)
        gradient = np.zeros((3, 3))
        for j in range(3):
            step = np.zeros(3)
            step[j] = _STEP
            gradient[:, j] = (field(p + step, still, 0.0) - field(p - step, still, 0.0)) / (2 * _STEP)
        pulls = np.linalg.eigvalsh(-0.5 * (gradient + gradient.T))
        at = (float(p[0]), float(p[1]), float(p[2]))
        found += [Steepness(float(pull), 0.0, at) for pull in pulls if pull > 1e-9]
    return sorted(found, key=lambda one: -one.stiffness.real)
