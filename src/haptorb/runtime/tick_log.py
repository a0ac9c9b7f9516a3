"""What was commanded before a tick, and what failed in it: two sums in the row, so that a recording can run again."""

from __future__ import annotations

from enum import IntFlag
from typing import Any, final

from haptorb.control.linkage import MODES, Linkage, Mode

__all__ = ["MODEL", "NO_TICK", "NotedLinkage", "TickCommand", "TickFailure", "TickLog", "find_model"]

MODEL = 2048  #: times the number of a model, from 1 on
NO_TICK = -1.0  #: instead of commands: the row that the loop leaves behind


class TickCommand(IntFlag):
    """The commands of a person or the loop to the tick, in the order in which the loop passes them."""

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
    """What failed in a tick; whether its world reduced or restored detail, or took over background work."""

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
    """Number of the model that is commanded in `commands`, from 0 on; −1: none.

    >>> find_model(2 * MODEL + TickCommand.STOP), find_model(TickCommand.STOP)
    (1, -1)
    """
    return commands // MODEL - 1


@final
class TickLog:
    """Sums of what happened since the last tick; `scale` is the torque scale that was commanded last."""

    def __init__(self) -> None:
        self.commands = self.failures = 0
        self.scale = 1.0

    def note(self, command: int) -> None:
        """A command arrived."""
        self.commands |= int(command)  # a sum of flags is ten times slower

    def note_mode(self, mode: Mode) -> None:
        """A new mode: the last one counts."""
        self.commands = int(self.commands & ~(TickCommand.TRANSLATE | TickCommand.ROTATE) | _MODES[mode])

    def note_clutch(self, engaged: bool) -> None:
        """A command to the clutch: the last one counts."""
        flag = TickCommand.HOLD if engaged else TickCommand.RELEASE
        self.commands = int(self.commands & ~(TickCommand.HOLD | TickCommand.RELEASE) | flag)

    def note_model(self, number: int) -> None:
        """A new model, by its `number` from 0."""
        self.commands = self.commands % MODEL + MODEL * (number + 1)

    def fail(self, failure: int) -> None:
        """`failure` happened."""
        self.failures |= int(failure)

    def fill(self, cells: Any, places: tuple[int, int, int]) -> None:
        """The tick is over: into the row `cells`, a memoryview, at the `places` of commands, failures and torque scale;
        all sums start again."""
        commands, failures, scale = places
        cells[commands], cells[failures], cells[scale] = self.commands, self.failures, self.scale
        self.commands = self.failures = 0


@final
class NotedLinkage:
    """The loop's commands to `linkage`, noted in `log`."""

    def __init__(self, linkage: Linkage, log: TickLog) -> None:
        self._linkage, self._log = linkage, log

    def set_mode(self, mode: Mode) -> None:
        """Go over to `mode` without a step."""
        self._linkage.set_mode(mode)
        self._log.note_mode(mode)

    def set_clutch(self, engaged: bool) -> None:
        """Take hold of the world's object, or let it go, without a step."""
        self._linkage.set_clutch(engaged)
        self._log.note_clutch(engaged)

    def set_torque_scale(self, scale: float) -> None:
        """Let the wrench come back `scale` times as strong, without a step."""
        self._linkage.set_torque_scale(scale)
        self._log.note(TickCommand.SCALE)
        self._log.scale = scale
