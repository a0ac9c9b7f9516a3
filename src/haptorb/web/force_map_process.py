"""The force map computed in a process of its own, with low priority.

Loading and running a world's compiled code holds a Python process up for as long as half a second. In the console's
process that would starve the servo's heartbeat and the hand on the stylus.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, final

from haptorb.arrays import Array
from haptorb.devices.base import Device
from haptorb.errors import HaptorbError
from haptorb.runtime.linux import start_python
from haptorb.web.force_map import Flags
from haptorb.worlds.base import Sum, World

__all__ = ["ForceMapProcess"]

_END_TIMEOUT_S = 1.0  #: for the process to end by itself [s]


@final
class ForceMapProcess:
    """Call it like a function: (name and values of a world, model, points (n, 3) [m]) → radial force (n,) [N] and
    saturated (n,).

    Started by `start` or the first call, and again if it has ended; a call blocks until the reply is there.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._process: subprocess.Popen[bytes] | None = None
        self._one_at_a_time = threading.Lock()
        #: the user's worlds by name, which the process cannot import
        self.own_worlds: Callable[[], Mapping[str, World]] = dict
        self.render: str | None = None  #: part of the wrench to render, overriding the world

    def __call__(self, name: str, values: Mapping[str, Any], model: str, points: Array) -> tuple[Array, Flags]:
        with self._one_at_a_time:
            process = self._ensure_process()
            assert process.stdin is not None
            assert process.stdout is not None
            own = self.own_worlds().get(name)
            try:
                world = None if own is None else _pack(own)
                pickle.dump((name, world, dict(values), model, points, self.render), process.stdin)
                process.stdin.flush()
                answer = pickle.load(process.stdout)
            except (OSError, EOFError, pickle.UnpicklingError, ValueError) as cause:
                self._end()
                raise HaptorbError("the process that computes it ended") from cause
            if isinstance(answer, str):
                raise HaptorbError(answer)
            force, saturated = answer
            return force, saturated

    def start(self) -> None:
        """Begin to load, so that the first call need not wait for it."""
        with self._one_at_a_time:
            self._ensure_process()

    def close(self) -> None:
        """End the process, if there is one."""
        # Not under the lock: a call that waits for an answer ends with the process.
        self._end()

    def _ensure_process(self) -> subprocess.Popen[bytes]:
        if self._process is not None and self._process.poll() is not None:
            self._end()
        if self._process is None:
            self._process = start_python("haptorb.web.force_map_process", stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            assert self._process.stdin is not None
            pickle.dump(self._device, self._process.stdin)
            self._process.stdin.flush()
        return self._process

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(OSError):
            process.stdin.close()  # that is what it waits for
        try:
            process.wait(_END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()


def _pack(world: World) -> bytes:
    # What a servo has loaded anyway: without one there is no own world, and nothing of it is needed.
    from haptorb.cluster import pack

    return pack(world)


def _select_lasting(world: World) -> World:
    """What of `world` has a map: a world with memory feels different at a place from one moment to the next."""
    parts = world.parts if isinstance(world, Sum) else (world,)
    return Sum(tuple(part for part in parts if not part.remembers))


def main() -> None:
    """Answer until the console closes the pipe: a device, then any number of (name, packed world or None, values,
    model, points, part to render or None)."""
    os.nice(10)
    questions, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a world's output is not a reply
    from haptorb.cluster import unpack
    from haptorb.simulation.force_map import force_map
    from haptorb.worlds import find_world

    # Nothing is compiled before the first question, which comes when the servo runs: at a first start the servo's
    # processes need the processors.
    device = pickle.load(questions)
    while True:
        try:
            name, packed, values, model, points, render = pickle.load(questions)
        except EOFError:
            return
        answer: object
        try:
            world = find_world(name)(**values) if packed is None else unpack(packed).replace(**values)
            answer = force_map(device, _select_lasting(world), points, model=model, render=render)
        except Exception as mistake:  # any exception of a world's own code is the reply
            answer = f"{type(mistake).__name__}: {mistake}"
        try:
            pickle.dump(answer, answers)
            answers.flush()
        except BrokenPipeError:
            os._exit(0)


if __name__ == "__main__":
    main()
