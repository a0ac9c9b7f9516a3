"""Force map computed in a separate process with low priority.

Loading and running the compiled code of a world blocks a Python process for up to half a second. In the console's
process that would delay the servo's heartbeat and the pointer.
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
from haptorb.runtime.linux import end_process, lower_share, send_beside, start_python
from haptorb.web.force_map import Flags
from haptorb.worlds.base import Sum, World

__all__ = ["ForceMapProcess"]


@final
class ForceMapProcess:
    """Process that computes force maps; call it as a `ForceMapSource`.

    (name and values of a world, model, points (n, 3) [m]) → radial force (n,) [N] and saturated (n,). The process is
    started by `start` or the first call, and again if it has ended; a call blocks until the reply.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._process: subprocess.Popen[bytes] | None = None
        self._sender = threading.Thread()  # sends the device to the process
        self._call_lock = threading.Lock()
        #: the user's worlds by name, which are sent to the process because it cannot import them
        self.own_worlds: Callable[[], Mapping[str, World]] = dict
        self.render: str | None = None  #: part of the wrench to render, overriding the world

    def __call__(self, name: str, values: Mapping[str, Any], model: str, points: Array) -> tuple[Array, Flags]:
        with self._call_lock:
            process = self._ensure_process()
            assert process.stdin is not None
            assert process.stdout is not None
            own = self.own_worlds().get(name)
            self._sender.join()  # until the device is sent, or the process has ended
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
        """Start the process in advance, so that the first call does not wait for it to load."""
        with self._call_lock:
            self._ensure_process()

    def close(self) -> None:
        """End the process, if there is one."""
        # Without the lock: a call that waits for a reply ends with the process.
        self._end()

    def _ensure_process(self) -> subprocess.Popen[bytes]:
        if self._process is not None and self._process.poll() is not None:
            self._end()
        if self._process is None:
            self._process = start_python("haptorb.web.force_map_process", stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            self._sender = send_beside(self._process, pickle.dumps(self._device), close=False)
        return self._process

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        assert process.stdout is not None
        end_process(process, 0.0)  # first: one that does not read would block the end of what is written to it
        with suppress(OSError):
            process.stdin.close()
        process.stdout.close()


def _pack(world: World) -> bytes:
    # Imported here: a servo has loaded it anyway, and without a servo there is no world to pack.
    from haptorb.child_process import pack

    return pack(world)


def _select_memoryless(world: World) -> World:
    """Parts of `world` without memory: the force of the others is not a function of the position."""
    parts = world.parts if isinstance(world, Sum) else (world,)
    return Sum(tuple(part for part in parts if not part.remembers))


def main() -> None:
    """Answer requests until the console closes the pipe.

    Input: a device, then any number of (name, packed world or None, values, model, points, part to render or None)."""
    lower_share(10)
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a world's output is not a reply
    from haptorb.child_process import unpack
    from haptorb.simulation.force_map import force_map
    from haptorb.worlds import find_world

    # Nothing is compiled before the first request, which comes when the servo runs: at a first start the servo's
    # processes need the processors.
    device = pickle.load(requests)
    while True:
        try:
            name, packed, values, model, points, render = pickle.load(requests)
        except EOFError:
            return
        answer: object
        try:
            world = find_world(name)(**values) if packed is None else unpack(packed).replace(**values)
            answer = force_map(device, _select_memoryless(world), points, model=model, render=render)
        except Exception as mistake:  # any exception in the code of a world is sent as the reply
            answer = f"{type(mistake).__name__}: {mistake}"
        try:
            pickle.dump(answer, answers)
            answers.flush()
        except BrokenPipeError:
            os._exit(0)


if __name__ == "__main__":
    main()
