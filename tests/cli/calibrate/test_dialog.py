"""Guided calibration: refused steps, resumption after an interruption, and one file at the end."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptorb.cli import main
from haptorb.cli.calibration_dialog import Dialog, check_steps, guide_calibration
from haptorb.cli.calibration_measurement import make_driver
from haptorb.cli.calibration_progress import ProgressFile
from haptorb.cli.calibration_steps import CalibrationEffort
from haptorb.cli.heat_measurement import HeatingSchedule
from haptorb.devices.loader import load
from haptorb.errors import CalibrationError, InputError, UnknownName
from haptorb.estimation.calibration_file import read_calibration
from haptorb.estimation.coil_calibration import excitation, magnetic_calibration
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.servo_process import disagreement
from oracles import wound_coils

OMNI = load("omni")
QUICK = check_steps(["rest", "currents", "magnetic", "tool"])
EFFORT = CalibrationEffort(levels=2, repeats=2)


class Bench(Driver):
    """The simulated device with a mistake in its wiring, and a memory for the calibration's id."""

    name, simulated = "bench", True

    def __init__(self, sample: Any = lambda s: s, truth: Any = OMNI) -> None:
        self.inner, self.pace = make_driver("sim", truth, 5)
        self.sample, self.kept, self.opened, self.written = sample, bytes(16), 0, 0

    @property
    def goal(self) -> Any:
        return self.inner.goal

    def open(self) -> None:
        self.opened += 1
        self.inner.open()

    def close(self) -> None:
        self.inner.close()

    def read(self, now: float) -> Any:
        return self.sample(self.inner.read(now))

    def write(self, duties: Any) -> Any:
        self.written += bool(np.any(duties))
        return self.inner.write(duties)

    def wrench_actual(self) -> Any:
        return self.inner.wrench_actual()

    @property
    def calibration(self) -> bytes:
        return self.kept

    def remember(self, calibration: bytes) -> bool:
        self.kept = calibration
        return True


@pytest.fixture
def held(monkeypatch: pytest.MonkeyPatch) -> None:
    """The simulated hand behind a bench is held by the same words."""
    from haptorb.cli import calibration_dialog

    hold_tool = calibration_dialog.hold_tool

    def hold(driver: Any, device: Any, hand: Any) -> None:
        hold_tool(getattr(driver, "inner", driver), device, hand)

    monkeypatch.setattr(calibration_dialog, "hold_tool", hold)


def through(bench: Bench, out: Path, **wants: Any) -> Any:
    return guide_calibration(OMNI, bench, out, pace=bench.pace, **{"steps": QUICK, "effort": EFFORT, **wants})


def test_all_steps_make_one_file_and_its_id_is_kept_by_the_device(tmp_path: Path) -> None:
    said: list[str] = []
    out = tmp_path / "omni.json"
    inner, pace = make_driver("sim", OMNI, 3)
    effort = CalibrationEffort(drives=3, course=HeatingSchedule(heating=90.0, cooling=60.0), led=12.0)
    found = guide_calibration(OMNI, inner, out, pace=pace, guide=Dialog(said.append), effort=effort)
    assert found is not None
    assert read_calibration(out).text() == found.text()
    assert found.heat is not None
    assert found.heat.model.winding_to_body == pytest.approx(OMNI.coils.heat.winding_to_body, rel=0.25)
    assert found.heat.coupling is not None
    assert found.heat.coupling.winding_to_core == pytest.approx(OMNI.coils.heat.coupling.winding_to_core, rel=0.4)
    assert sum("7/7" in line for line in said) == 1
    assert any("polarity correct" in line for line in said)
    assert found.sensors is not None
    assert found.sensors.failed == ()
    assert [path.name for path in tmp_path.iterdir()] == ["omni.json"]  # nothing else is left


@pytest.mark.usefixtures("held")
def test_the_device_keeps_the_id_of_what_was_written(tmp_path: Path) -> None:
    bench = Bench()
    found = through(bench, tmp_path / "omni.json")
    assert bench.kept == found.id == read_calibration(tmp_path / "omni.json").id
    assert len(found.id) == 16
    assert replace(found, residual=2 * found.residual).id != found.id


@pytest.mark.usefixtures("held")
def test_a_step_that_fails_is_named_and_nothing_after_it_is_taken(tmp_path: Path) -> None:
    out = tmp_path / "omni.json"
    wrong = Bench(lambda s: replace(s, currents=0.1 * s.currents))
    with pytest.raises(
        CalibrationError, match=r"step 'currents': .*shunt is wrong by a factor of ten.*repeat the command"
    ):
        through(wrong, out)
    assert not out.exists()
    assert wrong.opened == 2  # rest, currents, and not again
    mended, said = Bench(), []
    assert through(mended, out, guide=Dialog(said.append)) is not None
    assert "rest" in said[0]
    assert not any("1/4" in line for line in said)
    assert out.exists()
    assert not (tmp_path / "omni.json.steps").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: replace(s, currents=10 * s.currents), "shunt is wrong by a factor of ten"),
        (lambda s: replace(s, currents=s.currents * (1, 0, 1)), "coil 'y' carries.*unplugged"),
        (lambda s: replace(s, currents=s.currents[[1, 0, 2]]), "current sensor of coil 'y'"),
        (lambda s: replace(s, currents=s.currents * (1, 1, -1)), "current sensor is reversed"),
    ],
)
def test_wiring_mistakes_are_named(change: Callable[[Any], Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=message):
        through(Bench(change), tmp_path / "omni.json")


@pytest.mark.usefixtures("held")
def test_a_tool_with_its_magnet_the_wrong_way_round_is_named(tmp_path: Path) -> None:
    reversed_tool = replace(OMNI, tool=replace(OMNI.tool, remanence=-OMNI.tool.remanence))
    with pytest.raises(CalibrationError, match="reversed: the dome would pull"):
        through(Bench(truth=reversed_tool), tmp_path / "omni.json")
    assert not (tmp_path / "omni.json").exists()


def test_a_summit_without_a_tool_is_named(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="no tool found"):
        through(Bench(), tmp_path / "omni.json")  # nobody brings the bench's tool


@pytest.mark.usefixtures("held")
def test_who_stops_goes_on_later(tmp_path: Path) -> None:
    out, asked = tmp_path / "omni.json", []

    def until_magnetic(step: Any) -> bool:
        asked.append(step.name)
        return step.name != "magnetic"

    bench = Bench()
    assert through(bench, out, guide=Dialog(prompt=until_magnetic)) is None
    assert asked == ["rest", "currents", "magnetic"]
    assert not out.exists()
    asked.clear()
    assert through(Bench(), out, guide=Dialog(prompt=lambda step: bool(asked.append(step.name) or True))) is not None
    assert asked == ["magnetic", "tool"]


@pytest.mark.usefixtures("held")
def test_an_interruption_keeps_what_was_measured_and_leaves_the_coils_off(tmp_path: Path) -> None:
    out, bench = tmp_path / "omni.json", Bench()

    def interrupt(s: Any) -> Any:
        if bench.written > 400:  # in the middle of the schedule
            raise KeyboardInterrupt
        return s

    bench.sample = interrupt
    with pytest.raises(KeyboardInterrupt):
        through(bench, out)
    assert not bench.inner._duties.any()
    assert set(json.loads((tmp_path / "omni.json.steps").read_text())["steps"]) == {"rest", "currents"}
    assert through(Bench(), out) is not None


@pytest.mark.usefixtures("held")
def test_restart_forgets(tmp_path: Path) -> None:
    out = tmp_path / "omni.json"
    through(Bench(), out, steps=check_steps(["rest", "currents"]))
    bench = Bench()
    through(bench, out, restart=True)
    assert bench.opened == 5  # all four steps, and once for the id


def test_a_state_that_is_not_ours_is_not_taken_up(tmp_path: Path) -> None:
    out = tmp_path / "omni.json"
    kept = ProgressFile(out, OMNI, "serial:/dev/a", lambda: 1000.0)
    kept.store("rest", {"temperatures_k": [298.0] * 3})
    assert ProgressFile(out, OMNI, "serial:/dev/a", lambda: 2000.0).results
    for other, driver, now, why in (
        (OMNI, "serial:/dev/b", 2000.0, "serial:/dev/a"),
        (replace(OMNI, digest="f" * 64), "serial:/dev/a", 2000.0, "is ignored"),
        (OMNI, "serial:/dev/a", 1e6, "older than a day"),
        (OMNI, "serial:/dev/a", 0.0, "older than a day"),
    ):
        again = ProgressFile(out, other, driver, lambda now=now: now)
        assert not again.results
        assert why in again.left
    for damage in ("{", "[]", '{"format": "haptorb-calibration-steps-1"}', "\0"):
        kept.path.write_text(damage)
        assert "damaged" in ProgressFile(out, OMNI, "serial:/dev/a", lambda: 2000.0).left


def test_steps_have_names_and_an_order(tmp_path: Path) -> None:
    assert [step.name for step in check_steps(["magnetic", "rest"])] == ["rest", "magnetic"]
    with pytest.raises(UnknownName, match=r"step 'magnetics'.*did you mean 'magnetic'"):
        check_steps(["magnetics"])
    with pytest.raises(InputError, match="'tool' needs these steps first: rest, magnetic"):
        through(Bench(), tmp_path / "omni.json", steps=check_steps(["tool"]))


def test_sensors_of_one_axis_are_enough() -> None:
    """The radial readings of the nine real sensors: the same moments, and no bias from what they do not see."""
    from haptorb_papers.reproduce.zarate2020.hall_position import placements

    # for one axis the diagonals must be below the centre: from the equator only one sensor would see coil z
    OMNI = placements(load("omni"))["diagonals below"]
    draw = np.random.default_rng(4)
    wanted = excitation(OMNI)
    axes = OMNI.hall.positions / np.linalg.norm(OMNI.hall.positions, axis=1, keepdims=True)

    full = np.einsum("sim,nm->nsi", wound_coils.coil_fields(OMNI, OMNI.hall.positions), wanted)
    radial = (full * axes).sum(axis=2, keepdims=True) * axes
    noisy = radial + 2e-5 * draw.standard_normal((len(wanted), 9, 1)) * axes
    found = magnetic_calibration(OMNI, wanted, wanted, noisy, axes)
    scale = np.linalg.norm(OMNI.moment_per_current, axis=0)
    assert np.abs((found.moment_per_current - OMNI.moment_per_current) / scale).max() < 5e-3
    error = (found.moment_per_current - OMNI.moment_per_current) / found.uncertainty
    assert 0.3 < np.sqrt((error**2).mean()) < 2.0  # the uncertainty is what it says
    assert found.residual == pytest.approx(2e-5, rel=0.1)
    wrong = magnetic_calibration(OMNI, wanted, wanted, noisy)  # taken for three axes they would tell other moments
    assert np.abs((wrong.moment_per_current - OMNI.moment_per_current) / scale).max() > 0.2
    with pytest.raises(InputError, match="unit vectors"):
        magnetic_calibration(OMNI, wanted, wanted, noisy, 2 * axes)


def test_ids_that_disagree_are_told() -> None:
    mine, other, none = b"a" * 16, b"b" * 16, bytes(16)
    assert disagreement(None, mine) == disagreement(none, None) == disagreement(mine, mine) == ""
    assert "--calibration" in disagreement(mine, None)
    assert "stores no calibration id" in disagreement(none, mine)
    assert mine.hex() in disagreement(other, mine)
    assert other.hex() in disagreement(other, mine)


def test_a_warning_reaches_the_person(fake_bench: Any) -> None:
    assert fake_bench.warning.startswith("the device was calibrated")


@pytest.fixture
def fake_bench(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A running servo whose device keeps an id that nobody believes."""
    import sys

    import cloudpickle

    from haptorb.runtime import servo as servo_module
    from haptorb.runtime.assembly import assemble
    from haptorb.runtime.drivers.sim import SimDriver

    cloudpickle.register_pickle_by_value(sys.modules[__name__])

    def calibrate_fake(*arguments: Any, **named: Any) -> Any:
        tick = assemble(*arguments, **named)
        type(tick.driver).calibration = property(lambda self: b"k" * 16)
        assert isinstance(tick.driver, SimDriver)
        return tick

    monkeypatch.setattr(servo_module, "assemble", calibrate_fake)
    with servo_module.Servo(OMNI, record=False) as servo:
        yield servo


def test_the_command_in_a_script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["calibrate", "omni", "--driver", "serial:/dev/haptorb-nowhere"]) == 2
    assert "--yes" in capsys.readouterr().err  # pytest's standard input is no terminal
    assert main(["calibrate", "omni", "--driver", "serial:/dev/haptorb-nowhere", "--yes"]) == 2
    assert "there is no port" in capsys.readouterr().err
    assert main(["calibrate", "omni", "--steps", "rest,heating"]) == 2
    with suppress(SystemExit):
        main(["calibrate", "omni", "--steps", "rest,currents"])
    assert "also needs magnetic" in capsys.readouterr().err
    assert (tmp_path / "omni.calibration.json.steps").exists()
    with suppress(SystemExit):
        main(["calibrate", "omni", "--steps", "magnetic"])
    said = capsys.readouterr()
    assert "already done: rest, currents" in said.err
    assert "id " in said.out
    assert read_calibration("omni.calibration.json").heat is None


@pytest.mark.parametrize(("factor", "complaint"), [(1.0, ""), (0.1, "shunt is wrong by a factor of ten")])
def test_the_i2c_driver_is_calibrated_by_the_same_steps(factor: float, complaint: str, tmp_path: Path) -> None:
    """On simulated chips, whose currents follow the duties; `factor` is what a wrong shunt makes of them."""
    from haptorb.cli.calibration_measurement import Pace
    from haptorb.runtime.drivers.i2c import I2cDriver
    from oracles.chips import ChipBus, OpenBus, Thermometers

    bus, pwm, currents, _ = ChipBus.of_device()
    now = [0.0]

    def wait(seconds: float) -> None:
        now[0] += seconds
        for chip, duty in zip(currents, pwm.duties(), strict=True):
            chip.pass_time(2e-3, 20.0 * factor * float(duty))

    driver = I2cDriver(OMNI, OpenBus(bus), thermometers=Thermometers, clock=lambda: bus.now)
    steps, out, said = check_steps(["rest", "currents"]), tmp_path / "omni.json", []
    wants: dict[str, Any] = {"steps": steps, "pace": Pace(lambda: now[0], wait), "guide": Dialog(said.append)}
    if complaint:
        with pytest.raises(CalibrationError, match=complaint):
            guide_calibration(OMNI, driver, out, **wants)
    else:
        assert guide_calibration(OMNI, driver, out, **wants) is None
        kept = json.loads((tmp_path / "omni.json.steps").read_text())["steps"]
        assert kept["currents"]["resistance_ohm"] == pytest.approx([0.6] * 3, rel=0.01)
        assert "also needs magnetic" in said[-1]
    assert pwm.duties().tolist() == [0, 0, 0]
