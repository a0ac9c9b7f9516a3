"""What a trial's world really feels like at a place: asked of the controller's model, given by the exact device."""

from __future__ import annotations

from typing import final

from haptorb.control.allocation.for_device import tool_choice
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.worlds.world import World
from haptorb.worlds.wrench_part import WrenchPart

__all__ = ["DeliveredForce"]


@final
class DeliveredForce:
    """Force on a radial tool, current limits and model errors included; at rest, cold.

    The same chain as `haptorb.force_map`, as a vector and one place at a time.
    """

    def __init__(
        self, device: SphericalElectromagnet, world: World, model: str | None = None, render: WrenchPart | None = None
    ) -> None:
        self._device, self._world = device, world.for_device(device)
        self._model = device.check_model(model or device.models[0])
        choice = tool_choice(device, render)
        self._allocator = choice.allocators[choice.choose_part(world)]

    def force(self, direction: Array) -> Array:
        """(3,) force [N] on a tool in contact in `direction` (3,), a unit vector."""
        state = State.at(direction * self._device.contact_distance)
        asked = self._world.wrench(state)
        currents = self._allocator.allocate(self._device.wrench_map(state, self._model), asked).currents
        force: Array = self._device.wrench_map(state, "exact").wrench(currents)[:3]
        return force
