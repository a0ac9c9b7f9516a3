"""A failing bus: off is retried until confirmed, not reported before, and blocks engaging."""

from __future__ import annotations

import importlib.util
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from haptorb.control.trip_reasons import CoilState
from haptorb.devices.loader import load
from haptorb.errors import DriverError
from haptorb.runtime.drivers.i2c import I2cDriver
from haptorb.runtime.drivers.i2c_chips import Pca9685
from haptorb.runtime.drivers.i2c_guardian import RESPONSE_TIMEOUT_S, Guardian, switch_off, watch
from oracles.chips import TCA9534, Thermometers

ROOT = Path(__file__).resolve().parents[4]
SOME = np.array([0.25, -0.125, 0.0625])
NONE = np.zeros(3)


@pytest.fixture(scope="module")
def script() -> Iterator[ModuleType]:
    """benchmarks/safety/i2c_faults.py."""
    spec = importlib.util.spec_from_file_location("i2c_faults", ROOT / "benchmarks" / "safety" / "i2c_faults.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["i2c_faults"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["i2c_faults"]


class Bench:
    """A driver that pushes, on a bus that can be made to fail for a time."""

    def __init__(self, script: ModuleType) -> None:
        self.bus = script.FaultyBus()
        self.driver = I2cDriver(load("omni"), self.bus, thermometers=Thermometers, clock=lambda: self.bus.now)

    def fail_for(self, seconds: float) -> None:
        self.bus._at, self.bus._lasts = self.bus.count, seconds

    def tick(self, duties: np.ndarray) -> str:
        """What the driver complained of."""
        self.bus.chips.now += 1e-3
        try:
            self.driver.read(self.bus.now)
            self.driver.write(duties)
        except DriverError as cause:
            self.driver.write(NONE)
            return str(cause)
        return ""


@pytest.fixture
def bench(script: ModuleType) -> Iterator[Bench]:
    one = Bench(script)
    one.driver.open()
    assert one.driver.coil_state is CoilState.OFF
    assert [one.tick(SOME) for _ in range(4)] == [""] * 4
    assert one.driver.coil_state is CoilState.ON
    yield one
    one.driver.close()


def test_after_a_fault_of_the_bus_off_is_tried_until_the_chip_confirms_it(bench: Bench) -> None:
    bench.fail_for(0.05)
    unknown = 0
    while bench.bus.over is None or bench.bus.now < bench.bus.over:
        told = bench.tick(SOME)
        unknown += bench.driver.coil_state is CoilState.UNKNOWN and "COIL STATE UNKNOWN" in told
        assert bench.bus.zero or bench.driver.coil_state is not CoilState.OFF
    assert unknown > 20
    assert "COIL STATE UNKNOWN" not in bench.tick(SOME)
    assert bench.driver.coil_state is CoilState.OFF
    assert bench.bus.zero
    bench.tick(SOME)
    assert bench.bus.zero  # it stays off until somebody engages
    bench.driver.engage()
    bench.tick(SOME)
    assert bench.bus.pwm.duties() == pytest.approx(SOME, abs=1e-3)


@pytest.mark.parametrize("method", ["read", "write"])
def test_reading_alone_tries_to_switch_off_and_so_does_writing(bench: Bench, method: str) -> None:
    bench.fail_for(0.005)
    bench.tick(SOME)
    assert bench.driver.coil_state is CoilState.UNKNOWN
    for _ in range(8):
        bench.bus.chips.now += 1e-3
        with suppress(DriverError):
            bench.driver.read(bench.bus.now) if method == "read" else bench.driver.write(SOME)
    assert bench.driver.coil_state is CoilState.OFF
    assert bench.bus.zero


def test_nobody_engages_before_off_is_confirmed(bench: Bench) -> None:
    bench.fail_for(0.05)
    bench.tick(SOME)
    with pytest.raises(DriverError, match="coil state unknown"):
        bench.driver.engage()
    assert bench.driver.write(SOME).tolist() == [0, 0, 0]
    while bench.driver.coil_state is not CoilState.OFF:
        bench.tick(SOME)
    bench.driver.engage()


def test_a_chip_that_acknowledges_and_does_not_obey_is_not_called_off(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(type(bench.bus.pwm), "_store", lambda self, byte: None)
        bench.bus.chips.chips[1].present = False  # a current sensor
        for _ in range(20):
            bench.tick(SOME)
        assert bench.driver.coil_state is CoilState.UNKNOWN
        assert not bench.bus.zero
    bench.tick(SOME)
    assert bench.driver.coil_state is CoilState.OFF
    assert bench.bus.zero


def test_a_chip_that_lost_its_supply_is_set_up_before_it_is_believed(bench: Bench) -> None:
    bench.fail_for(0.01)
    while bench.driver.coil_state is not CoilState.UNKNOWN:
        bench.tick(SOME)
    bench.bus.pwm.power_on()
    while bench.driver.coil_state is not CoilState.OFF:
        bench.tick(SOME)
    assert bench.bus.pwm.registers[0] == 0x20
    assert bench.bus.pwm.frequency == pytest.approx(1526, abs=1)


def test_closing_without_a_confirmation_complains(script: ModuleType) -> None:
    one = Bench(script)
    one.driver.open()
    one.tick(SOME)
    one.fail_for(5.0)
    with pytest.raises(DriverError, match="COIL STATE UNKNOWN"):
        one.driver.close()
    assert one.driver.coil_state is CoilState.UNKNOWN
    assert one.bus.now - one.bus.fault_start < 1.0  # it does not try for ever
    one.driver.close()


def test_zero_duties_are_confirmed_as_off_soon_and_the_next_duties_flow_again(bench: Bench) -> None:
    for _ in range(30):
        bench.tick(NONE)
    assert bench.driver.coil_state is CoilState.OFF
    assert bench.bus.zero
    bench.tick(SOME)
    assert bench.driver.coil_state is CoilState.ON
    assert bench.bus.pwm.duties() == pytest.approx(SOME, abs=1e-3)


def test_faults_at_every_place(script: ModuleType) -> None:
    """What benchmarks/safety/i2c_faults.py finds, in a reduced form."""
    found = script.faults(12, seed=5)
    assert found["wrong"] == []
    assert found["off_in_time"] == 12
    assert found["pins_ms_max"] < 31.0


@pytest.mark.slow
def test_faults_at_every_place_at_length(script: ModuleType) -> None:
    found = script.faults(1000)
    assert found["wrong"] == []


def test_the_guardian_tries_until_the_chip_confirms_it(script: ModuleType) -> None:
    bus = script.FaultyBus(at=0, lasts=3.0)
    bus.chips.transfer([(0x60, bytes((0x00, 0x20)))])
    bus.chips.transfer([(0x60, bytes((0x06, 0, 0x10, 0, 0)))])  # output 0 always on
    assert not bus.zero

    def wait(seconds: float) -> None:
        bus.chips.now += seconds

    switch_off(Pca9685(bus), wait)
    assert bus.zero
    assert bus.now - 3.0 < 0.02


def test_a_heartbeat_is_answered() -> None:
    beats, host = os.pipe()
    answers, guardian = os.pipe()
    thread = threading.Thread(target=watch, args=(beats, lambda: None, 60.0, guardian))
    thread.start()
    os.write(host, b"1")
    heard, _, _ = select.select((answers,), (), (), 10.0)
    assert heard
    assert os.read(answers, 10) == b"."
    os.close(host)
    thread.join(10)
    os.close(answers)
    os.close(guardian)


def test_a_guardian_that_does_not_answer_is_noticed_by_the_clock() -> None:
    now = [0.0]
    guardian = Guardian(["sh", "-c", "printf +; exec sleep 60"], clock=lambda: now[0])
    assert guardian.wait_until_ready(10.0)
    guardian.beat(False)
    now[0] = 5.0
    guardian.beat(True)  # nobody spoke for a long time, and nobody had to
    now[0] += RESPONSE_TIMEOUT_S
    guardian.beat(True)
    now[0] += 1e-3
    with pytest.raises(DriverError, match="for 10 ms"):
        guardian.beat(True)
    assert guardian.end(0.0) or guardian.end(10.0)
    with pytest.raises(DriverError):
        guardian.beat(True)


@pytest.mark.parametrize("deed", [signal.SIGSTOP, signal.SIGKILL])
def test_a_real_guardian_that_stops_or_dies_is_noticed(
    script: ModuleType, tmp_path: Path, deed: signal.Signals
) -> None:
    """How soon, `python benchmarks/safety/i2c_faults.py` measures."""
    port = script.SharedPort(tmp_path)
    with I2cDriver(load("omni"), port, thermometers=Thermometers, watchdog=False) as driver:
        for _ in range(5):
            try:
                assert script.time_detection(port, driver, deed, 5) < 1.0
                break
            except DriverError:  # this computer was busy for too long, before anything was done
                driver.engage()
        first = port.guardian
        driver.engage()
        assert port.guardian is not first
        assert first.ended
        driver.write(SOME)
        assert port.pwm.duties() == pytest.approx(SOME, abs=1e-3)
    assert port.guardian.ended
    assert not port.pwm.duties().any()
    port.end()


def wire(script: ModuleType, **told: object) -> tuple[I2cDriver, object, TCA9534]:
    bus = script.FaultyBus()
    expander = next(chip for chip in bus.chips.chips if isinstance(chip, TCA9534))
    return I2cDriver(load("omni"), bus, thermometers=Thermometers, clock=lambda: bus.now, **told), bus, expander


def tie_low(bus: object, chip: TCA9534) -> None:
    bus.pwm.oe = chip.wired[3] = lambda: False


def no_trigger(bus: object, chip: TCA9534) -> None:
    chip.moved = lambda pins: None


def too_long(bus: object, chip: TCA9534) -> None:
    _monostable(chip).width = 0.05


def too_short(bus: object, chip: TCA9534) -> None:
    _monostable(chip).width = 0.005


def not_there(bus: object, chip: TCA9534) -> None:
    chip.present = False


def _monostable(chip: TCA9534) -> object:
    return next(cell.cell_contents for cell in chip.moved.__closure__)


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        (tie_low, "low although nothing triggers"),
        (no_trigger, "does not stay low"),
        (too_long, "low although nothing triggers|still low 30 ms after"),
        (too_short, "holds for 5.* ms, not"),
        (not_there, "responds at 0x20"),
    ],
)
def test_without_a_working_monostable_it_does_not_open(script: ModuleType, fault: object, told: str) -> None:
    driver, bus, chip = wire(script)
    fault(bus, chip)
    with pytest.raises(DriverError, match=told) as refused:
        driver.open()
    assert bus.zero
    assert "--no-watchdog" in str(refused.value) or fault is too_short
    driver, bus, chip = wire(script, watchdog=False)
    fault(bus, chip)
    driver.open()
    driver.close()


def test_a_monostable_that_was_bridged_later_is_noticed_when_engaging(script: ModuleType) -> None:
    driver, bus, chip = wire(script)
    driver.open()
    bus.chips.chips[1].present = False
    driver.read(bus.now)
    driver.read(bus.now)
    with pytest.raises(DriverError, match="does not respond"):
        driver.read(bus.now)
    bus.chips.chips[1].present = True
    tie_low(bus, chip)
    with pytest.raises(DriverError, match="low although nothing triggers"):
        driver.engage()
    assert driver.write(SOME).tolist() == [0, 0, 0]
    driver.close()


def test_when_every_process_stands_still_the_monostable_switches_off(
    bench: Bench, check_limit: Callable[[str, float, float, str], None]
) -> None:
    assert bench.bus.pwm.duties().any()
    steps = 0
    while bench.bus.pwm.duties().any() and steps < 1000:
        bench.bus.chips.now += 1e-4
        steps += 1
    assert not bench.bus.zero  # the chip itself would continue without limit
    check_limit("monostable: outputs off after the last trigger", 0.1 * steps, 30.0, "ms")
