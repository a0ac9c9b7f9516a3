"""Host side of the emulated microcontroller: starts it, sends commands, and connects it to a simulated device.

The emulator is a separate program (`make -C firmware emulator`; it links libsimavr, which is GPL) that runs the real
firmware with its serial line on a pseudo-terminal. This module starts it and answers its physics socket.
"""

from __future__ import annotations

import re
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from queue import Empty, Queue
from types import TracebackType
from typing import Self, final

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import DriverError
from haptorb.estimation.types import Pose
from haptorb.runtime.drivers.base import HallSensors
from haptorb.runtime.linux import raise_priority
from haptorb.simulation.registry import simulate

__all__ = ["EmulatedDevice", "Emulator"]

_ASKED = struct.Struct("=4d")  # time [s], duties
_MAX_STEP_S = 0.05  #: longest step; a longer one is a restart of the emulator

_MCU = {"m328p": "atmega328p", "m2560": "atmega2560"}


@final
class EmulatedDevice:
    """A simulated electromagnet behind a Unix socket: duties in, currents, Hall voltages and temperatures out.

    Its Hall sensors have three axes, or with hall_axes 1 the radial one only, as firmware built for such reads them.
    `goal(t)` returns the hand's goal for the tool, (position (3,) [m], quaternion (4,)); without it the hand stays.
    """

    def __init__(
        self,
        device: SphericalElectromagnet,
        path: Path,
        goal: Callable[[float], tuple[Array, Array]] | None = None,
        seed: int = 0,
        hall_axes: int = 3,
    ) -> None:
        self.path = path
        self.simulation = simulate(device, seed)
        self._goal = goal
        self._hall = HallSensors(device.hall.positions, hall_axes)
        self._shares = np.full((3, device.sensors), 0.5)
        state = self.simulation.state()
        self._rest = (state.p.copy(), np.array([0.0, 0.0, 0.0, 1.0]))
        self.simulation.advance(1e-3, np.zeros(device.channels), *self._rest)  # compile in advance
        self.simulation.sample(0.0, 0.0, True)
        self.simulation.reset(seed)
        self._lock = threading.Lock()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(path))
        self._listener.listen(1)
        self._thread = threading.Thread(target=self._serve, name="emulated physics", daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        raise_priority()  # the emulator, and firmware time, waits for every answer
        with suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                with connection, suppress(ConnectionError):
                    self._answer(connection)

    def _answer(self, connection: socket.socket) -> None:
        last: float | None = None
        while True:
            asked = connection.recv(_ASKED.size, socket.MSG_WAITALL)
            if len(asked) < _ASKED.size:
                return
            t, *duties = _ASKED.unpack(asked)
            with self._lock:
                dt = 0.0 if last is None else min(max(t - last, 0.0), _MAX_STEP_S)
                last = t
                self.simulation.advance(dt, np.array(duties), *(self._goal(t) if self._goal else self._rest))
                sample = self.simulation.sample(t, t, True)
            self._shares[: self._hall.axes] = self._hall.shares(sample.field)
            numbers = np.concatenate((sample.currents, self._shares.ravel(), sample.temperatures - 273.15))
            connection.sendall(numbers.tobytes())

    def place(self, p: Array, q: Array) -> None:
        """Put the simulated tool at p (3,) [m], turned by the quaternion q (4,), at rest."""
        with self._lock:
            self.simulation.place(p, q)

    def pose(self, now: float) -> Pose:
        """Pose of the simulated tool at `now` [s], as from an ideal tracker."""
        with self._lock:
            state = self.simulation.state()
            return Pose(now, state.R_SR.copy(), state.p.copy(), state.w.copy(), state.v.copy(), valid=True)

    def wrench_actual(self) -> Array:
        """True wrench (6,) of coils and core on the tool [N, N·m]."""
        with self._lock:
            return self.simulation.wrench_actual().copy()

    def close(self) -> None:
        """May be called twice."""
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.path.unlink(missing_ok=True)


@final
class Emulator:
    """A running emulator, with its serial line at `port`; `send` and `execute` pass commands of its `main.c`.

    Firmware time runs at real time; `set_pace` slows it down, for computers that are too busy to feed a watchdog
    of 15 ms. Times that it reports are firmware times.

    Raises DriverError if `board` is not known, if emulator or firmware has not been built, or if it does not become
    ready within 20 s.
    """

    def __init__(self, build: Path, port: Path, board: str = "m328p", physics: EmulatedDevice | None = None) -> None:
        if board not in _MCU:
            raise DriverError(f"there is no emulated board '{board}'; choose one of {', '.join(_MCU)}")
        program, firmware = build / "emulator", build / f"omni-{board}.elf"
        for file in (program, firmware):
            if not file.exists():
                raise DriverError(f"there is no {file}; build it with `make firmware` and `make -C firmware emulator`")
        self.port = str(port)
        command = [str(program), str(firmware), "--mcu", _MCU[board], "--link", str(port)]
        if physics is not None:
            command += ["--physics", str(physics.path), "--lockstep"]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, bufsize=1
        )
        raise_priority(self._process.pid)  # real hardware has no scheduling delays
        self._lines: Queue[str] = Queue()
        self._listener = threading.Thread(target=self._listen, name="emulator", daemon=True)
        self._listener.start()
        self.expect_line("@ready")

    def _listen(self) -> None:
        assert self._process.stdout is not None
        with suppress(ValueError):  # closed while reading
            for line in self._process.stdout:
                if line.startswith("@"):  # other lines are the library's
                    self._lines.put(line.strip())

    def expect_line(self, start: str, timeout: float = 20.0) -> str:
        """Wait for a line that begins with `start`; drop others before. DriverError if none comes in `timeout` [s]."""
        end = time.monotonic() + timeout
        while True:
            try:
                line = self._lines.get(timeout=max(end - time.monotonic(), 1e-3))
            except Empty:
                raise DriverError(f"the emulator did not report '{start}' within {timeout:g} s") from None
            if line.startswith(start):
                return line

    def send(self, command: str) -> None:
        """Send a command without waiting. Raises DriverError if the emulator has ended."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(command + "\n")
            self._process.stdin.flush()
        except OSError as cause:
            raise DriverError("the emulator has ended") from cause

    def execute(self, command: str) -> None:
        """Send a command and wait until it is done; other lines in the meantime are stored.

        Raises DriverError if the emulator rejects the command, does not reply within 20 s, or has ended.
        """
        lines: list[str] = []
        self.send(command)
        while True:
            try:
                line = self._lines.get(timeout=20.0)
            except Empty:
                raise DriverError(f"the emulator did not execute '{command}'") from None
            if line.startswith("@error"):
                raise DriverError(line)
            if line.startswith("@done"):
                break
            lines.append(line)
        for one in lines:
            self._lines.put(one)

    def set_pace(self, pace: float = 0.02) -> None:
        """Run firmware time at `pace` times real time."""
        self.execute(f"pace {pace}")

    def wait(self, seconds: float) -> None:
        """Advance firmware time by `seconds`, as fast as this computer can; then continue at the pace before."""
        end = float(self.status()["t"]) + seconds
        self.execute(f"skip {seconds}")
        while float(self.status()["t"]) < end:
            time.sleep(0.005)

    def discard_lines(self) -> None:
        """Drop all lines received so far."""
        while not self._lines.empty():
            self._lines.get()

    def status(self) -> dict[str, str]:
        """Counters and state, by name."""
        self.send("status")
        words = dict(re.findall(r"(\w+)=(\S+)", self.expect_line("@status")))
        self.expect_line("@done")
        return words

    @property
    def pid(self) -> int:
        """Process id of the emulator."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether the emulator runs."""
        return self._process.poll() is None

    def close(self) -> None:
        """May be called twice."""
        if self._process.poll() is None:
            with suppress(DriverError):
                self.send("quit")
            try:
                self._process.wait(5.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
        self._process.wait()
        self._listener.join(5.0)
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
