"""Which part of the world's wrench the tick renders: chosen with the world, or detected from what the world asks."""

from __future__ import annotations

from typing import final

from haptorb.control.allocation.allocator import Allocator
from haptorb.control.allocation.wrench_choice import PART_NUMBERS, WrenchChoice
from haptorb.control.protection.protection import Protection
from haptorb.numerics.arrays import Array
from haptorb.worlds.world import World
from haptorb.worlds.wrench_part import WrenchPart

__all__ = ["RenderedPart"]

_NO_CHOICE = -1.0


@final
class RenderedPart:
    """The allocator in force and its number in the row, −1 for a device without a choice.

    wrench     (6,) the world's wrench of this tick [N, N·m], filled by the tick
    is_open    whether the part still follows from the wrenches
    """

    def __init__(
        self, allocator: Allocator, choice: WrenchChoice | None, protection: Protection, wrench: Array
    ) -> None:
        self.allocator, self.number, self.is_open = allocator, _NO_CHOICE, False
        self._choice, self._protection = choice, protection
        self._numbers = wrench.data.cast("B").cast("d")  # single numbers come out of it ten times faster
        self._part: WrenchPart = "force"
        self._has_pushed = False

    def begin(self, world: World) -> None:
        """Render the part that a person chose, or the one that `world` asks."""
        if self._choice is None:
            return
        opens = self._choice.is_open(world)
        if not (opens and self.is_open):  # the same world with other values: what it has asked before still counts
            self._has_pushed = False
            self._render(self._choice.choose_part(world))
        self.is_open = opens

    def follow(self) -> None:
        """Render also the part that the world asks for the first time in this tick."""
        n = self._numbers
        pushes = bool(n[0] or n[1] or n[2])
        if self._part == "force" and (n[3] or n[4] or n[5]):
            self._render("both" if pushes or self._has_pushed else "torque")
        elif self._part == "torque" and pushes:
            self._render("both")
        self._has_pushed = self._has_pushed or pushes

    def _render(self, part: WrenchPart) -> None:
        assert self._choice is not None
        self._part, self.number = part, float(PART_NUMBERS[part])
        self.allocator = self._choice.allocators[part]
        arm = 0.0 if part == "force" else self._choice.arm
        self._protection.change_part(pushes=part != "torque", arm=arm)  # safety: turns-are-counted
