"""Commands before a tick and failures in it, as two bit sums in the row, so that a recording can be replayed."""

from __future__ import annotations

from enum import IntFlag
from typing import Any, final

from haptorb.control.linkage import MODES, Linkage, Mode

__all__ = ["MODEL", "NO_TICK", "NotedLinkage", "TickCommand", "TickFailure", "TickLog", "find_model"]

MODEL = 2048  #: times the number of a model, from 1 on
NO_TICK = -1.0  #: in place of commands: marks the final row of the loop


class TickCommand(IntFlag):
    """Commands of the user or the loop to the tick, in the order in which the loop passes them."""

    EXCUSE = 32
    STOP = 1
    ENGAGE = 2
    TRANSLATE = 128
    ROTATE = 256
    SCALE = 64
    COOL = 4
    HOLD = 512
    RELEASE = 1024
    WORLD = 8
    REPLACE = 16


class TickFailure(IntFlag):
    """Failures in a tick; whether its world reduced or restored detail, or used the result of background work."""

    READ = 1
    WRITE = 2
    ENGAGE = 4
    WORLD = 8
    MEMORY = 16
    ALLOCATION = 32
    LESS_DETAIL = 64
    MORE_DETAIL = 128
    WORK = 256


_MODES: dict[Mode, TickCommand] = dict(zip(MODES, (TickCommand.TRANSLATE, TickCommand.ROTATE), strict=True))


def find_model(commands: int) -> int:
    """Number of the model in `commands`, from 0 on; −1: none.

    >>> find_model(2 * MODEL + TickCommand.STOP), find_model(TickCommand.STOP)
    (1, -1)
    """
    return commands // MODEL - 1


@final
class TickLog:
    """Bit sums of commands and failures since the last tick; `scale` is the last commanded torque scale."""

    def __init__(self) -> None:
        self.commands = self.failures = 0
        self.scale = 1.0

    def record(self, command: int) -> None:
        """Record a command."""
        self.commands |= int(command)  # `|` of IntFlag members is ten times slower

    def record_mode(self, mode: Mode) -> None:
        """Record a new mode; it replaces an earlier one."""
        self.commands = int(self.commands & ~(TickCommand.TRANSLATE | TickCommand.ROTATE) | _MODES[mode])

    def record_clutch(self, engaged: bool) -> None:
        """Record a command to the clutch; it replaces an earlier one."""
        flag = TickCommand.HOLD if engaged else TickCommand.RELEASE
        self.commands = int(self.commands & ~(TickCommand.HOLD | TickCommand.RELEASE) | flag)

    def record_model(self, number: int) -> None:
        """Record a new model, by its `number` from 0; it replaces an earlier one."""
        self.commands = self.commands % MODEL + MODEL * (number + 1)

    def fail(self, failure: int) -> None:
        """Record `failure`."""
        self.failures |= int(failure)

    def fill(self, cells: Any, places: tuple[int, int, int]) -> None:
        """Write the sums to the row `cells`, a memoryview, at the `places` of commands, failures and torque scale, and
        reset them."""
        commands, failures, scale = places
        cells[commands], cells[failures], cells[scale] = self.commands, self.failures, self.scale
        self.commands = self.failures = 0


@final
class NotedLinkage:
    """Passes the loop's commands on to `linkage`, and records them in `log`."""

    def __init__(self, linkage: Linkage, log: TickLog) -> None:
        self._linkage, self._log = linkage, log

    def set_mode(self, mode: Mode) -> None:
        """Change to `mode` without a step."""
        self._linkage.set_mode(mode)
        self._log.record_mode(mode)

    def set_clutch(self, engaged: bool) -> None:
        """Engage or release the clutch to the world's object, without a step."""
        self._linkage.set_clutch(engaged)
        self._log.record_clutch(engaged)

    def set_torque_scale(self, scale: float) -> None:
        """Scale the torques by `scale`, without a step."""
        self._linkage.set_torque_scale(scale)
        self._log.record(TickCommand.SCALE)
        self._log.scale = scale
