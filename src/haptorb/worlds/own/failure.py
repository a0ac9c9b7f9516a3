"""Messages when a world's code fails: the error, and where in the user's files it was raised."""

from __future__ import annotations

import linecache
import traceback
from pathlib import Path
from types import CodeType

import numpy as np

from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.errors import HaptorbError, InputError, quote
from haptorb.numerics.arrays import Array
from haptorb.worlds.bound_world import MemoryNotFinite, bind_world
from haptorb.worlds.world import World

__all__ = ["check_wrench", "describe_failure", "fit_world", "keep_source", "try_world"]

_PACKAGE = str(Path(__file__).parents[2])
_FIRST = 1e-3  #: time step of a world's first call [s]
_FRAMES = 6  #: of the user's code, the innermost; a recursion has a thousand


def check_wrench(wrench: object) -> Array:
    """`wrench` itself, (6,) [N, N·m]. Raises InputError if it is not such an array; the guard checks its numbers."""
    if not isinstance(wrench, np.ndarray):
        raise InputError(f"wrench must return an array of 6 numbers (force, torque); got {quote(wrench)}")
    if wrench.shape != (6,):
        raise InputError(f"wrench must return an array of shape (6,): force, torque; got shape {wrench.shape}")
    return wrench


def describe_failure(world: World, cause: BaseException) -> str:
    """The error in one line, then file, line and source of the user's code that it went through, outermost first.

    An invalid wrench is not raised by a line of the user's code; the message then shows the first line of `wrench`.
    """
    if isinstance(cause, SystemExit):
        text = f"the world called sys.exit({cause})"
    elif isinstance(cause, InputError | MemoryNotFinite):
        text = str(cause)
    else:
        text = f"{type(cause).__name__}: {cause}"
    frames = [
        (frame.f_code, line)
        for frame, line in traceback.walk_tb(cause.__traceback__)
        if not frame.f_code.co_filename.startswith(_PACKAGE)
    ]
    code = _code_of(world)
    if not frames and code is not None:
        frames = [(code, code.co_firstlineno)]
    lines = [text]
    for found, line in frames[-_FRAMES:]:
        lines.append(f'  File "{found.co_filename}", line {line}, in {found.co_qualname}')
        if source := linecache.getline(found.co_filename, line).strip():
            lines.append(f"    {source}")
    return "\n".join(lines)


def keep_source(world: World) -> None:
    """Read the file of `world` now, so that `describe_failure` does not open it later and shows the lines that ran."""
    code = _code_of(world)
    if code is not None:
        linecache.checkcache(code.co_filename)
        linecache.getlines(code.co_filename)


def fit_world(world: World, device: Device) -> World:
    """`world.for_device(device)`: the world that `device` renders; a world with memory is started once.

    Raises InputError with the place in the user's code if that fails, or as the world itself does if `device` cannot
    render it.
    """
    try:
        fitted: object = world.for_device(device)
        if isinstance(fitted, World):
            bind_world(fitted, _FIRST)
    except HaptorbError:
        raise
    except BaseException as cause:  # the user's code: also sys.exit
        if isinstance(cause, KeyboardInterrupt):
            raise
        raise InputError(f"world '{world.name}' failed: {describe_failure(world, cause)}") from cause
    if not isinstance(fitted, World):
        raise InputError(
            f"for_device of world '{world.name}' must return a World for the device (may be the same one); got "
            f"{quote(fitted)}"
        )
    return fitted


def try_world(world: World, device: Device) -> World:
    """`world` itself, after one call at the device's rest position.

    Raises InputError with the place in the user's code if it fails there, or if `device` cannot render it.
    """
    fitted = fit_world(world, device)
    try:
        rendered = bind_world(fitted, _FIRST) or fitted
        check_wrench(rendered.wrench(State.at(device.rest_position, R_SR=np.eye(3))))
    except BaseException as cause:  # the user's code: also sys.exit
        if isinstance(cause, KeyboardInterrupt):
            raise
        raise InputError(f"world '{world.name}' failed: {describe_failure(world, cause)}") from cause
    return world


def _code_of(world: World) -> CodeType | None:
    """Of the world's `wrench`, if Python code computes it that is not this package's."""
    code = getattr(world.wrench_code, "__code__", None)
    return code if isinstance(code, CodeType) and not code.co_filename.startswith(_PACKAGE) else None
