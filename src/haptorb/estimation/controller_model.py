"""Model of the device that the controller inverts, with a smooth change to another model at run time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from haptorb.arrays import StateArray, Stateful, choose, make_numbers
from haptorb.devices.base import Device, State, WrenchMap

__all__ = ["FADE", "ControllerModel"]

#: transition time between two models [s]: a smooth change for the hand, without a step of the currents
FADE: Final = 0.05


class ControllerModel(Stateful):
    """Wrench map of `device` by its model `name`; None: the device's first.

    After `change` the map goes over from the old model's to the new one's within `FADE`, a little in every tick, so the
    allocated currents have no step. Raises UnknownName for a model that the device does not have.

    >>> from haptorb.devices.loader import load
    >>> ControllerModel(load("omni")).name
    'exact'
    """

    def __init__(self, device: Device, name: str | None = None) -> None:
        self._device = device
        self._asked = self._name = self._before = device.check_model(name or device.models[0])
        self._share = 1.0  # weight of the model `_name`; the rest is `_before`
        self._t = 0.0  # of the last map during a transition
        self._numbers = make_numbers("asked", "model", "before", "share", "t")

    def state_arrays(self) -> Mapping[str, StateArray]:
        """Models by their number, from 0; weight of the newer one; time of the last map [s]."""
        return {"change": self._numbers[0]}

    def gather_state(self) -> None:
        """Copy the models into the state arrays."""
        cells, number = self._numbers[1], self._device.models.index
        cells[0], cells[1], cells[2] = number(self._asked), number(self._name), number(self._before)
        cells[3], cells[4] = self._share, self._t

    def apply_state(self) -> None:
        """Restore the models from the state arrays."""
        asked, name, before, self._share, self._t = self._numbers[1]
        models = self._device.models
        self._asked, self._name, self._before = (models[choose(one, len(models))] for one in (asked, name, before))

    @property
    def name(self) -> str:
        """The active model, or the one that a transition leads to."""
        return self._asked

    def change(self, name: str) -> None:
        """Change to the model `name` from the next map on, or after the present transition."""
        self._asked = self._device.check_model(name)

    def wrench_map(self, state: State) -> WrenchMap:
        """Wrench map at `state`; GeometryError where the device's model has none."""
        if self._share >= 1.0:
            if self._asked == self._name:
                return self._device.wrench_map(state, self._name)
            self._before, self._name, self._share, self._t = self._name, self._asked, 0.0, state.t
        new = self._device.wrench_map(state, self._name)
        self._share = min(self._share + max(state.t - self._t, 0.0) / FADE, 1.0)
        self._t = state.t
        old = self._device.wrench_map(state, self._before)
        a, b = self._share, 1.0 - self._share
        return WrenchMap(a * new.matrix + b * old.matrix, a * new.passive + b * old.passive)
