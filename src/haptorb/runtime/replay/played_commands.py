"""What was commanded before a tick, commanded again in the loop's order."""

from __future__ import annotations

from contextlib import suppress

from haptorb.control.clutch.modes import MODES
from haptorb.errors import InputError
from haptorb.runtime.tick.tick import Tick
from haptorb.runtime.tick.tick_log import TickCommand, find_model

__all__ = ["play_commands"]

_EXCUSE, _STOP, _ENGAGE, _SCALE, _COOL = map(
    int, (TickCommand.EXCUSE, TickCommand.STOP, TickCommand.ENGAGE, TickCommand.SCALE, TickCommand.COOL)
)
_MODES = tuple(zip((int(TickCommand.TRANSLATE), int(TickCommand.ROTATE)), MODES, strict=True))
_CLUTCH = ((int(TickCommand.HOLD), True), (int(TickCommand.RELEASE), False))


def play_commands(tick: Tick, commands: int, scale: float) -> None:
    """Tell `tick` the sum `commands` of a row, all but those of its world; scale: of a motor's torques, if known
    [1]."""
    if commands & _EXCUSE:
        tick.excuse_lateness()
    if commands & _STOP:
        tick.stop()
    if commands & _ENGAGE:
        tick.engage()
    for flag, mode in _MODES:
        if commands & flag:
            tick.joining.set_mode(mode)
    if (model := find_model(commands)) >= 0:
        with suppress(InputError):  # another estimator, that has one model only
            tick.change_model(model)
    if commands & _SCALE:
        tick.joining.set_torque_scale(scale)
    if commands & _COOL:
        tick.cool()
    for flag, engaged in _CLUTCH:
        if commands & flag:
            tick.joining.set_clutch(engaged)
