"""Which part of a world's wrench a device renders: what a person chose, or what the world asks; with its allocator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, final

from haptorb.control.allocation.allocator import Allocator
from haptorb.worlds.world import World
from haptorb.worlds.wrench_part import PARTS, WrenchPart

__all__ = ["PART_NUMBERS", "WrenchChoice"]

PART_NUMBERS: Final[dict[WrenchPart, int]] = {part: number for number, part in enumerate(PARTS)}  #: in recordings


@final
class WrenchChoice:
    """The allocators of a device that can render force, torque or both.

    allocators   one for each part
    arm          at which a hand holds the tool against turning [m]
    fixed        the part that a person chose; None: the one that the world asks
    weight       1 N weighs as much as this arm [m] × 1 N of torque, where both are asked
    """

    def __init__(
        self, allocators: Mapping[WrenchPart, Allocator], arm: float, fixed: WrenchPart | None, weight: float
    ) -> None:
        self.allocators = dict(allocators)
        self.arm = arm
        self.fixed = fixed
        self.weight = weight

    def choose_part(self, world: World) -> WrenchPart:
        """The part of `world` to begin with: force for one that does not say what it asks."""
        return self.fixed or world.asks or "force"

    def is_open(self, world: World) -> bool:
        """Whether the part is to follow from the wrenches of `world`."""
        return self.fixed is None and world.asks is None
