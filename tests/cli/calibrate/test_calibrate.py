"""Calibration through a driver: results, rejected inputs, and a file that belongs to one device."""

import json
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from haptorb.cli import main
from haptorb.cli.calibration_measurement import calibrate, make_driver
from haptorb.cli.thermal_record import thermal_record
from haptorb.devices.base import HeatCoupling
from haptorb.devices.loader import load
from haptorb.errors import CalibrationError, InputError, UnknownName
from haptorb.estimation.calibration_file import Calibration, MeasuredHeat, read_calibration, write_calibration
from haptorb.estimation.sensor_calibration import without_errors
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.thermal import TwoNode
from oracles.endurance_fit import endurance_fit

OMNI = without_errors(load("omni"))  # sensors with noise and steps only
ALONE = replace(OMNI, coils=replace(OMNI.coils, heat=replace(OMNI.coils.heat, coupling=None)))
HEAT = {"winding_capacity": 15.0, "body_capacity": 40.0, "winding_to_body": 1.4, "body_to_air": 0.15}


class WiringError(Driver):
    """Another driver whose duties and samples are changed on the way."""

    name, simulated = "rewired", True

    def __init__(self, inner, duties=lambda d: d, sample=lambda s: s):
        self.inner, self.duties, self.sample = inner, duties, sample
        self.closed = False

    def open(self):
        self.inner.open()

    def close(self):
        self.closed = True
        self.inner.close()

    def read(self, now):
        return self.sample(self.inner.read(now))

    def write(self, duties):
        return self.duties(self.inner.write(self.duties(duties)))

    def wrench_actual(self):
        return self.inner.wrench_actual()


def calibrate_simulation(device=OMNI, truth=None, **changes):
    """Calibrate `device` on a simulation of `truth`."""
    inner, pace = make_driver("sim", truth or device, 3)
    driver = WiringError(inner, **changes)
    try:
        return calibrate(device, driver, pace=pace)
    finally:
        assert driver.closed
        assert not inner.simulation.quantise(inner._duties).any()  # coils off, however it ended


def refusal(**changes):
    with pytest.raises(CalibrationError) as failure:
        calibrate_simulation(**changes)
    return str(failure.value)


def test_what_differs_from_the_file_is_found():
    """A device whose moments are 4 % and 2° off its file, and whose coil z has 5 % more resistance."""
    skew = np.array([[1.04, 0.035, 0.0], [0.0, 0.97, 0.0], [0.0, 0.02, 1.03]])
    coils = replace(OMNI.coils, resistance=OMNI.coils.resistance * (1.0, 1.0, 1.05))
    truth = replace(OMNI, moment_per_current=skew @ OMNI.moment_per_current, coils=coils)
    found = calibrate_simulation(truth=truth)
    scale = np.linalg.norm(truth.moment_per_current, axis=0)
    assert np.abs((found.moment_per_current - truth.moment_per_current) / scale).max() < 0.003
    assert found.resistance == pytest.approx(coils.resistance, rel=0.01)
    assert found.simulated
    believed = found.apply(OMNI)
    assert np.array_equal(believed.moment_per_current, found.moment_per_current)
    assert believed.digest == OMNI.digest


def test_faults_of_the_wiring_are_named():
    swapped, reversed_z = [1, 0, 2], np.array([1.0, 1.0, -1.0])
    assert "coil 'x' changes the current sensor of coil 'y'" in refusal(duties=lambda d: d[swapped])
    assert "coil 'z' is negative" in refusal(sample=lambda s: replace(s, currents=s.currents * reversed_z))
    assert "coil 'y' carries" in refusal(sample=lambda s: replace(s, currents=s.currents * (1, 0, 1)))
    assert "applied no duty" in refusal(duties=lambda d: d * (1, 0, 1))


def test_a_coil_wound_the_other_way_is_named():
    moments = OMNI.moment_per_current * (1.0, -1.0, 1.0)
    assert "coil 'y' produces a reversed moment" in refusal(truth=replace(OMNI, moment_per_current=moments))


def test_a_wrong_shunt_is_named():
    assert "value of its shunt" in refusal(sample=lambda s: replace(s, currents=s.currents * (1, 0.5, 1)))


def test_a_tool_nearby_is_named_and_nothing_is_driven():
    driven = []

    def remember(duties):
        driven.append(np.abs(duties).max())
        return duties

    inner = SimDriver.of(OMNI, 2e-3)  # without the hand that holds the tool away
    _, pace = make_driver("sim", OMNI)
    with pytest.raises(CalibrationError, match="take the tool"):
        calibrate(OMNI, WiringError(inner, duties=remember), pace=pace)
    assert max(driven) == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: replace(s, currents=s.currents + np.array([0, 0.5, 0])), "coil 'y' reads"),
        (lambda s: replace(s, temperatures=s.temperatures + 80), "let it cool"),
        (lambda s: replace(s, field=s.field * np.nan), "no finite reading"),
        (lambda s: replace(s, field=s.field * np.linspace(1, 1.5, 9)[:, None]), "not dipolar"),
    ],
)
def test_a_device_that_is_not_fit_is_refused(change, message):
    assert message in refusal(sample=change)


def test_the_file_keeps_every_digit_and_names_its_device(tmp_path):
    found, path = calibrate_simulation(), tmp_path / "omni.json"
    coupling = HeatCoupling(48.0, (0.4, 0.5, 0.6))
    heated = replace(found, heat=MeasuredHeat(TwoNode(15.0, 73.0, 1.9, 0.33), coupling))
    write_calibration(heated, path)
    again = read_calibration(path)
    assert again.text() == heated.text()
    assert again.apply(OMNI).coils.heat.body_to_air == 0.33
    assert again.apply(OMNI).coils.heat.coupling == coupling
    assert again.apply(OMNI).coils.heat.tolerance == OMNI.coils.heat.tolerance
    with pytest.raises(CalibrationError, match=r"the heat of uncoupled coils.*repeat the heat step"):
        replace(found, heat=MeasuredHeat(TwoNode(15.0, 73.0, 1.9, 0.33))).apply(OMNI)
    with pytest.raises(CalibrationError, match="exists"):
        write_calibration(found, path)
    assert read_calibration(path).heat is not None  # the first one is still there
    write_calibration(found, path, overwrite=True)
    assert read_calibration(path).heat is None
    other = replace(OMNI, digest="0" * 64)
    with pytest.raises(CalibrationError, match="not to 'omni' with file 000000000000"):
        found.apply(other)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("format", "haptorb-calibration-99", "format must be"),
        ("moment_per_current_m2", [[1, 2], [3, 4]], "shape"),
        ("moment_per_current_m2", [[0, 0, 0]] * 3, "singular"),
        ("resistance_ohm", [0.6, 0.6, -1], "positive"),
        ("resistance_ohm", [0.6, "much", 1], "must be numbers"),
        ("residual_t", None, "finite numbers"),
        ("digest", 7, "must be a text"),
        ("heat", {"winding_capacity": 1}, "heat must be"),
        ("heat", {**HEAT, "core_capacity": 50.0}, "heat must be.*winding_to_core"),
        ("heat", {**HEAT, "core_capacity": 50.0, "winding_to_core": [0.5]}, "winding_to_core must.*shape"),
        ("heat", {**HEAT, "core_capacity": 50.0, "winding_to_core": [0.5, 0, 0.5]}, "positive"),
        ("extra", 1, "'extra' is not a known key"),
    ],
)
def test_damaged_files_are_refused(key, value, message):
    n = OMNI.channels
    good = Calibration(
        "omni", OMNI.digest, np.eye(n), np.eye(n), np.zeros((9, 3)), np.ones(n), 0.0, 1.0, 0.0, None, True
    )
    raw = json.loads(good.text())
    raw[key] = value
    with pytest.raises(CalibrationError, match=message):
        Calibration.parse(json.dumps(raw), "file")
    assert Calibration.parse(good.text(), "file").device == "omni"
    with pytest.raises(CalibrationError, match="is not JSON"):
        Calibration.parse("{", "file")
    del raw["device"]
    with pytest.raises(CalibrationError):
        Calibration.parse(json.dumps(raw), "file")


def table(path, rows):
    path.write_text("t_s,power_w,winding_degc,boundary_degc\n" + "\n".join(rows) + "\n")
    return path


def test_heat_from_a_table(tmp_path):
    coil, step, rises = endurance_fit(60.0), 1.0, np.zeros(2)
    rows = []
    for n in range(360):
        watts = 17.0 if n < 180 else 0.0
        winding = f"{25 + rises[0]:.2f}" if watts else ""
        rows.append(f"{n * step},{watts},{winding},{25 + rises[1]:.2f}")
        rises = coil.step(step) @ (*rises, watts)
    found = thermal_record(table(tmp_path / "heat.csv", rows), ALONE).identify()
    assert found.endurance(60.0, 240.0) == pytest.approx(5.0, rel=0.1)
    assert found.endurance(60.0, 60.0) == pytest.approx(60.0, rel=0.1)
    assert found.model.steady_rise(17.0)[0] == pytest.approx(60.0, rel=0.1)
    short = [f"{n},17.0,{30 + n // 4},{25 + n // 9}" for n in range(40)]
    with pytest.raises(CalibrationError, match="does not determine"):
        thermal_record(table(tmp_path / "short.csv", short), ALONE).identify()


def test_the_angle_between_coils_is_told():
    said = []
    inner, pace = make_driver("sim", OMNI)
    calibrate(OMNI, inner, pace=pace, notify=said.append)
    x, y = OMNI.moment_per_current[:, 0], OMNI.moment_per_current[:, 1]
    truth = np.degrees(np.arccos(x @ y / np.linalg.norm(x) / np.linalg.norm(y)))
    told = float(next(line for line in said if "x and y" in line).split(": ")[1].split("°")[0])
    assert told == pytest.approx(truth, abs=0.1)
    assert (told < 90) == (truth < 90)


def test_heat_from_a_recording(tmp_path, monkeypatch):
    """Currents, resistances and boundaries of the loop's rows; the warmest coil is taken."""
    coil, step, rises, rows = endurance_fit(60.0), 0.1, np.zeros(2), []
    heated, coils = 1, OMNI.coils
    for n in range(3600):
        i = 5.0 if n < 1800 else 0.0
        warm = float(coils.resistance_at(np.full(3, 298.15 + rises[0]))[heated])
        rows.append((n * step, i, warm, 298.15 + rises[1]))
        rises = coil.step(step) @ (*rises, i * i * warm)
    t, i, R, edge = np.array(rows).T

    class FakeRecording:
        digest = OMNI.digest

        def __init__(self, path):
            self.t, self.metadata = t, {"device": {"name": "omni", "digest": self.digest}}

        def __len__(self):
            return len(t)

        def __getitem__(self, name):
            still = {"current_measured": 0.0, "resistance": 0.6, "boundary": 298.15}[name]
            out = np.full((len(t), 3), still)
            out[:, heated] = {"current_measured": i, "resistance": R, "boundary": edge}[name]
            return out

    monkeypatch.setattr("haptorb.recording.recording.Recording", FakeRecording)
    record = thermal_record("heat.mcap", ALONE)
    assert np.isnan(record.measured.winding[-1, 0])
    found = record.identify()
    assert found.endurance(60.0, 60.0) == pytest.approx(60.0, rel=0.1)
    assert found.model.steady_rise(17.0)[0] == pytest.approx(60.0, rel=0.1)
    monkeypatch.setattr(FakeRecording, "digest", "e" * 64)
    with pytest.raises(CalibrationError, match="was recorded on device 'omni' with file eeee"):
        thermal_record("heat.mcap", ALONE)


def test_tables_that_are_no_records(tmp_path):
    with pytest.raises(CalibrationError, match="at least 20"):
        thermal_record(table(tmp_path / "a.csv", ["0,1,25,25"]), ALONE)
    with pytest.raises(CalibrationError, match="line 3"):
        thermal_record(table(tmp_path / "b.csv", ["0,1,25,25", "1,1,25,warm"]), ALONE)
    with pytest.raises(CalibrationError, match="line 22: t_s"):
        thermal_record(table(tmp_path / "c.csv", [f"{n},1,25,25" for n in range(20)] + ["20,,25,25"]), ALONE)
    (tmp_path / "d.csv").write_text("t,p\n1,2\n")
    with pytest.raises(CalibrationError, match="column t_s is missing"):
        thermal_record(tmp_path / "d.csv", ALONE)
    with pytest.raises(CalibrationError, match="cannot be read"):
        thermal_record(tmp_path / "none.csv", ALONE)


def write_coupled_table(path, always_on=False):
    """Each coil at 20 W for three minutes, then three of cooling, as the device file's network has it."""
    network = OMNI.coils.heat.network(3)
    step, rises, rows = network.step(1.0), np.zeros(7), []
    for n in range(720):
        watts = np.full(3, 0.6)
        if n < 540:
            watts[n // 180] = 20.0
        if always_on:
            watts[2] = 20.0
        cells = [n, *watts, *(25 + rises[:3]), *(25 + rises[3:6])]
        rows.append(",".join(f"{cell:.3f}" for cell in cells))
        rises = step @ [*rises, *watts]
    heads = [f"{what}_{name}_{unit}" for what, unit in (("power", "w"), ("winding", "degc"), ("boundary", "degc"))
             for name in "xyz"]  # fmt: skip
    path.write_text("\n".join([",".join(["t_s", *heads]), *rows]) + "\n")
    return path


def test_coupled_heat_from_a_table_by_the_command(tmp_path, monkeypatch, capsys):
    """--thermal: the couplings are in the file; of one coil always on, or of one coil alone, nothing is written."""
    monkeypatch.chdir(tmp_path)
    write_coupled_table(tmp_path / "stuck.csv", always_on=True)
    table(tmp_path / "one.csv", ["0,1,25,25"])
    for name, message in (("stuck", "coil 'z' is on in the whole record"), ("one", "column power_x_w is missing")):
        assert main(["calibrate", "omni", "--thermal", f"{name}.csv"]) == 2
        assert message in capsys.readouterr().err
        assert not list(tmp_path.glob("omni*"))
    write_coupled_table(tmp_path / "heat.csv")
    with suppress(SystemExit):
        main(["calibrate", "omni", "--thermal", "heat.csv", "--steps", "rest,currents,magnetic"])
    out = capsys.readouterr().out
    assert "heat of all coils together: 8.1 W continuous in each" in out
    heat = read_calibration("omni.calibration.json").heat
    assert heat.coupling.winding_to_core == pytest.approx((0.5, 0.5, 0.5), rel=0.02)
    assert heat.model.body_to_air == pytest.approx(OMNI.coils.heat.body_to_air, rel=0.02)


def test_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with suppress(SystemExit):
        main(["calibrate", "omni", "--steps", "rest,currents,magnetic,fields,tool"])
    said = capsys.readouterr()
    assert "5/5" in said.err
    assert "condition" in said.out
    assert "simulated" in said.out
    assert read_calibration("omni.calibration.json").digest == OMNI.digest
    assert main(["calibrate", "omni"]) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["calibrate", "pmsm"]) == 2
    assert main(["calibrate", "omni", "--out", "nowhere/a.json"]) == 2


def test_doors_that_are_none():
    with pytest.raises(UnknownName, match="driver"):
        make_driver("usb", OMNI)
    with pytest.raises(InputError, match="serial:PORT"):
        make_driver("serial:", OMNI)
