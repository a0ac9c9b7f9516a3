"""Which part of the world's wrench the tick renders: chosen with the world, or detected from what the world asks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

from haptorb.control.allocation.allocator import Allocator
from haptorb.control.allocation.wrench_choice import PART_NUMBERS, WrenchChoice
from haptorb.control.protection.protection import Protection
from haptorb.numerics.arrays import Array
from haptorb.numerics.state_arrays import StateArray, Stateful, choose, make_numbers
from haptorb.worlds.world import World
from haptorb.worlds.wrench_part import PARTS, WrenchPart

__all__ = ["RenderedPart"]

_NO_CHOICE = -1.0


@final
class RenderedPart(Stateful):
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
        self._kept = make_numbers("number", "is_open", "part", "has_pushed")

    def state_arrays(self) -> Mapping[str, StateArray]:
        """The part by its number in the row, and in `PARTS`; whether it may still change, and has pushed."""
        return {"part": self._kept[0]}

    def gather_state(self) -> None:
        """Note them."""
        cells = self._kept[1]
        cells[0], cells[1], cells[2], cells[3] = self.number, self.is_open, PARTS.index(self._part), self._has_pushed

    def apply_state(self) -> None:
        """Take them over, with the allocator of that part."""
        self.number, is_open, part, has_pushed = self._kept[1]
        self.is_open, self._has_pushed = bool(is_open), bool(has_pushed)
        self._part = PARTS[choose(part, len(PARTS))]
        if self._choice is not None:
            self.allocator = self._choice.allocators[self._part]

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
