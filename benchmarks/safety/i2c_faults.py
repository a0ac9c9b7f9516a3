"""I²C faults at every point of a session: time until the coils are off, and premature confirmations.

    python benchmarks/safety/i2c_faults.py [--faults 1000] [--guardians 100] [--json]

First the driver on simulated chips in simulated time: open, push, rest, over-current, engage, push, close. At one
transfer of it the bus begins to refuse (what was being written arrives in part) or to hang (every transfer for 10 ms,
which is what the driver asks of the kernel), or the PWM chip to acknowledge without obeying, for 0.1 ms to 10 s.
Measured is the time from the bus's first answer until the registers read zero and the driver says OFF; OFF said with a
register not zero is a failure. Where `close` has given up, the guardian's own loop goes on. "at the pins": until the
monostable has disabled the outputs, counted from the beginning of the fault. Then a real guardian process is stopped or
killed while a driver ticks at 1 kHz: when does the driver notice?
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, Listener
from pathlib import Path
from typing import Any

import numpy as np

from haptorb.control.trip_reasons import CoilState
from haptorb.devices.loader import load
from haptorb.errors import DriverError
from haptorb.runtime.drivers.i2c import I2cDriver, Port
from haptorb.runtime.drivers.i2c_chips import Pca9685
from haptorb.runtime.drivers.i2c_guardian import Guardian, switch_off
from haptorb.runtime.linux import request_real_time

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))  # the chips as their data sheets have them

from oracles.chips import ChipBus, Thermometers

LIMIT = 0.020  #: from the first answer of the bus to registers that read zero; for noticing the guardian's end [s]
HANG = 0.010  #: what one transfer takes that hangs [s]
PWM = 0x60  #: the PWM chip's address
TICK = 1e-3
SOME = np.array([0.25, -0.125, 0.0625])
NONE = np.zeros(3)


#: a guardian as it is, but for its bus: the chips of the process that listens at argv[1]
GUARDIAN = """
import sys
from multiprocessing.connection import Client
from haptorb.runtime.drivers.i2c_guardian import serve
class Bus:
    def __init__(self):
        self.line = Client(sys.argv[1], "AF_UNIX")
    def transfer(self, messages):
        self.line.send(messages)
        answer = self.line.recv()
        if isinstance(answer, OSError):
            raise answer
        return answer
serve(Bus(), 0x60)
"""


class FaultyBus:
    """Simulated chips whose bus fails from transfer `at` on for `lasts` [s]."""

    def __init__(self, at: int | None = None, lasts: float = 0.0, kind: str = "nack", seed: int = 0) -> None:
        self.chips, self.pwm, self.currents, _ = ChipBus.of_device()
        self.count = 0
        self.fault_start: float | None = None
        self.pins: float | None = None  #: from the first failure to pins that are low [s]
        self._at, self._lasts, self._kind = at, lasts, kind
        self._random = random.Random(seed)

    @property
    def now(self) -> float:
        """The bus's time [s]."""
        return self.chips.now

    @property
    def over(self) -> float | None:
        """When the bus answers again [s]; None before it fails."""
        return None if self.fault_start is None else self.fault_start + self._lasts

    def transfer(self, messages: Sequence[tuple[int, bytes | int]]) -> list[bytes]:
        """As chips do, unless it fails now: then a part of the first message may have arrived."""
        number, self.count = self.count, self.count + 1
        if number == self._at:
            self.fault_start = self.now
        if self.fault_start is not None and self.pins is None and not self.pwm.duties().any():
            self.pins = self.now - self.fault_start
        if self.over is None or self.now >= self.over:
            return self.chips.transfer(messages)
        address, what = messages[0]
        if self._kind == "disobeys":
            heard = [(a, w) for a, w in messages if not (a == PWM and isinstance(w, bytes) and len(w) > 1)]
            return self.chips.transfer(heard) if heard else []
        if isinstance(what, bytes) and len(what) > 1:
            with suppress(OSError):
                self.chips.transfer([(address, what[: self._random.randint(1, len(what) - 1)])])
        self.chips.now += HANG if self._kind == "hang" else 50e-6
        raise OSError(110 if self._kind == "hang" else 121, "the bus fails")

    def close(self) -> None:
        """The chips stay."""

    @property
    def zero(self) -> bool:
        """Whether the registers let no current flow."""
        return not any(self.pwm.read_output(output) for output in range(3))


class Session:
    """Everything that a driver does, tick by tick; `found` says what went wrong."""

    def __init__(self, bus: FaultyBus) -> None:
        self.bus = bus
        self.driver = I2cDriver(load("omni"), bus, thermometers=Thermometers, clock=lambda: bus.now)
        self.next = 0.0
        self.found = ""
        self.failed = False  #: the driver noticed the bus's fault
        self.off: float | None = None  #: from the bus's first answer to zero registers and OFF [s]

    def tick(self, duties: Any, ampere: float = 20.0) -> bool:
        """One period of the loop; whether the driver did not complain."""
        bus, driver = self.bus, self.driver
        bus.chips.now = max(bus.now, self.next)
        self.next = bus.now + TICK
        for chip, duty in zip(bus.currents, bus.pwm.duties(), strict=True):
            chip.pass_time(0.6e-3, ampere * float(duty))
        well = True
        try:
            driver.read(bus.now)
            driver.write(duties)
        except DriverError:
            well = False
            self.judge_error()
            with suppress(DriverError):
                driver.write(NONE)
        self.look()
        return well

    def judge_error(self) -> None:
        """Was it the fault of the bus, or is that over without a consequence?"""
        over = self.bus.over
        self.failed = self.failed or (over is not None and self.bus.now <= over + 2 * HANG)

    def look(self) -> None:
        """Nobody may say OFF while a register is not zero."""
        if self.driver.coil_state is CoilState.OFF and not self.bus.zero:
            self.found = "said OFF with a register that is not zero"

    def run(self) -> None:
        """The session to its end, or to coils that are off for good."""
        try:
            self.driver.open()
        except DriverError:
            self.look()
            self.found = self.found or ("" if self.bus.zero else "on after an open that failed")
            self.off = 0.0
            return
        steps: list[tuple[int, Any, float]] = [(8, SOME, 20.0), (30, NONE, 20.0), (8, SOME, 20.0), (3, SOME, 200.0)]
        if not self.all_of(steps):
            self.recover()
            return
        if self.bus.pwm.duties().any():  # perhaps only from the last tick on: the chip may not have obeyed before
            if not self.all_of([(3, SOME, 200.0)]):
                self.recover()
                return
            self.found = self.found or "over-current was not noticed"
        self.shut()

    def all_of(self, steps: list[tuple[int, Any, float]]) -> bool:
        """Tick through `steps`; False as soon as the driver complains."""
        return all(self.tick(duties, ampere) for count, duties, ampere in steps for _ in range(count))

    def recover(self) -> None:
        """Zero until OFF is said; engage when it is; push; close."""
        for again in range(3):
            self.until_off()
            if self.found:
                return
            try:
                self.driver.engage()
            except DriverError:
                self.judge_error()
                self.look()
                continue
            if self.all_of([(8, SOME, 20.0)]):
                break
            if again == 2:
                self.found = "did not come back"
        self.until_off() if self.driver.fault else None
        self.shut()

    def until_off(self) -> None:
        """Tick with zero duties until the driver says OFF; when that was, counted from the bus's first answer."""
        while self.driver.coil_state is not CoilState.OFF and not self.found:
            self.tick(NONE)
            if self.bus.over is not None and self.bus.now - self.bus.over > 1.0:
                self.found = "not OFF a second after the bus answered again"
        self.note()

    def note(self) -> None:
        """Off now."""
        over = self.bus.over
        if self.failed and over is not None and self.bus.now >= over and self.off is None:
            self.off = self.bus.now - over

    def shut(self) -> None:
        """Close; where that gives up, the guardian has the last word."""
        before = self.bus.fault_start
        with suppress(DriverError):
            self.driver.close()
            self.failed |= before is None
            self.look()
            self.note()
            return
        self.failed = True
        if self.driver.coil_state is not CoilState.UNKNOWN:
            self.found = "close complained and did not say UNKNOWN"

        def wait(seconds: float) -> None:
            self.bus.chips.now += seconds

        switch_off(Pca9685(self.bus), wait)
        if not self.bus.zero:
            self.found = "the guardian ended with a register that is not zero"
        self.note()


def places() -> list[int]:
    """Transfers at which the bus begins to fail: each of a session, and every 25th of the monostable's long test."""
    bus = FaultyBus()
    session = Session(bus)
    session.driver.open()
    opened = bus.count
    session.driver.close()
    bus = FaultyBus()
    session = Session(bus)
    session.run()
    few = sorted({*range(40), *range(40, opened - 40, 25), *range(opened - 40, opened)})
    return [*few, *range(opened, bus.count)]


def faults(count: int, seed: int = 1) -> dict[str, Any]:
    """`count` sessions, each with one fault."""
    draw = random.Random(seed)
    where = places()
    draw.shuffle(where)
    late, pins, wrong, rode = [], [], [], 0
    for number in range(count):
        at = where[number % len(where)]
        lasts = 10.0 ** draw.uniform(-4.0, 1.0)
        kind = draw.choice(("nack", "hang", "disobeys"))
        bus = FaultyBus(at, lasts, kind, number)
        session = Session(bus)
        session.run()
        if session.found:
            wrong.append(f"transfer {at}, {kind} for {1e3 * lasts:.1f} ms: {session.found}")
        if session.off is None:
            rode += 1
        else:
            late.append(session.off)
            if session.off > LIMIT:
                wrong.append(f"transfer {at}, {kind} for {1e3 * lasts:.1f} ms: off after {1e3 * session.off:.1f} ms")
        if (
            bus.pins is not None and session.off is not None and kind != "disobeys"
        ):  # the driver keeps triggering that one
            pins.append(bus.pins)
    return {
        "faults": count,
        "places": len(where),
        "wrong": wrong[:10],
        "off_in_time": count - len(wrong),
        "rode_through": rode,
        "off_ms_max": 1e3 * max(late, default=0.0),
        "off_ms_p50": 1e3 * float(np.median(late)) if late else 0.0,
        "pins_ms_max": 1e3 * max(pins, default=0.0),
    }


class SharedPort(Port):
    """Simulated chips in this process, and a real guardian process that reaches them through a socket."""

    name = "i2c:shared"

    def __init__(self, folder: Path) -> None:
        self.chips, self.pwm, self.currents, _ = ChipBus.of_device()
        self.pwm.oe = lambda: False
        self.guardian: Guardian | None = None
        self._path = str(folder / "chips")
        self._one = threading.Lock()
        self._listener = Listener(self._path, "AF_UNIX")
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                threading.Thread(target=self._serve, args=(self._listener.accept(),), daemon=True).start()

    def _serve(self, line: Connection) -> None:
        with suppress(EOFError, OSError):
            while True:
                messages = line.recv()
                try:
                    line.send(self.transfer(messages))
                except OSError as cause:
                    line.send(cause)

    def transfer(self, messages: Sequence[tuple[int, bytes | int]]) -> list[bytes]:
        """One at a time, as on a bus."""
        with self._one:
            return self.chips.transfer(messages)

    def open(self) -> Any:
        """The chips."""
        return self

    def watcher(self) -> Guardian:
        """A process."""
        self.guardian = Guardian([sys.executable, "-c", GUARDIAN, self._path])
        return self.guardian

    def close(self) -> None:
        """The chips stay."""

    def end(self) -> None:
        """Listen no longer."""
        self._listener.close()


def time_detection(port: SharedPort, driver: I2cDriver, deed: signal.Signals, ticks: int) -> float:
    """After `ticks` ticks do `deed` to the guardian; how long the driver drives on [s]. The coils are off then."""
    start = time.monotonic()
    done: float | None = None
    number = 0
    while True:
        for chip, duty in zip(port.currents, port.pwm.duties(), strict=True):
            chip.pass_time(0.6e-3, 20.0 * float(duty))
        try:
            driver.read(number * TICK)
            driver.write(SOME)
        except DriverError:
            if done is None:
                raise
            took = time.monotonic() - done
            if port.pwm.duties().any() or driver.coil_state is not CoilState.OFF:
                raise DriverError("noticed, but the coils are not off") from None
            return took
        number += 1
        if number == ticks and port.guardian is not None:
            os.kill(port.guardian.pid, deed)
            done = time.monotonic()
        time.sleep(max(0.0, start + number * TICK - time.monotonic()))


def engage(driver: I2cDriver) -> None:
    """A person engages, again where the last guardian is not gone yet."""
    for _ in range(50):
        with suppress(DriverError):
            driver.engage()
            return
        time.sleep(0.02)
    driver.engage()


def guardians(count: int, seed: int = 1) -> dict[str, list[float]]:
    """How long each of `count` stops, and as many deaths, of a guardian went unnoticed [s]."""
    draw = random.Random(seed)
    found: dict[str, list[float]] = {"stopped": [], "killed": []}
    with tempfile.TemporaryDirectory() as folder:
        port = SharedPort(Path(folder))
        request_real_time()  # as the servo is, where it may
        with I2cDriver(load("omni"), port, thermometers=Thermometers, watchdog=False) as driver:
            for _ in range(count):
                for name, deed in (("stopped", signal.SIGSTOP), ("killed", signal.SIGKILL)):
                    for _ in range(5):  # a busy computer trips by itself; that is not what is asked here
                        with suppress(DriverError):
                            found[name].append(time_detection(port, driver, deed, draw.randint(5, 25)))
                            break
                        engage(driver)
                    engage(driver)
        port.end()
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Both parts, and one line of verdict."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faults", type=int, default=1000)
    parser.add_argument("--guardians", type=int, default=100)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    bus = faults(options.faults)
    detection = guardians(options.guardians)
    result = {**bus, **{f"{name}_ms_max": 1e3 * max(times, default=0.0) for name, times in detection.items()}}
    in_time = {name: sum(one <= LIMIT for one in times) for name, times in detection.items()}
    result |= {f"{name}_in_time": f"{in_time[name]} of {options.guardians}" for name in detection}
    well = bus["off_in_time"] == options.faults and not bus["wrong"]
    well &= all(one == options.guardians for one in in_time.values())
    if options.json:
        print(json.dumps(result | {"well": well}))
        return 0 if well else 1
    say: Callable[[str], None] = print
    say(f"bus faults at {bus['places']} transfers: registers zero and OFF within 20 ms of the bus's answer: "
        f"{bus['off_in_time']} of {options.faults} (longest {bus['off_ms_max']:.1f} ms, "
        f"median {bus['off_ms_p50']:.1f} ms; {bus['rode_through']} ridden through)")  # fmt: skip
    say(f"current at the pins for at most {bus['pins_ms_max']:.1f} ms of a fault (monostable)")
    for line in bus["wrong"]:
        say(f"  {line}")
    for name, times in detection.items():
        say(f"guardian {name}: noticed within 20 ms {in_time[name]} of {options.guardians}, "
            f"longest {1e3 * max(times, default=0.0):.1f} ms")  # fmt: skip
    say("well" if well else "NOT WELL")
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
