"""Calibration by a load cell of a device with tolerances, and rejected readings."""

from __future__ import annotations

import csv
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from haptorb.cli import main
from haptorb.devices.base import State, rotation_to_axis
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.errors import CalibrationError
from haptorb.estimation.calibration_file import Calibration
from haptorb.estimation.coil_calibration import excitation, magnetic_calibration
from haptorb.estimation.load_cell_calibration import LoadRecord, calibrate_by_loads, list_columns, read_loads
from haptorb.rotations import quaternion
from haptorb.simulation.electromagnet_specimen import (
    ElectromagnetSpecimen,
    compute_fields,
    draw_electromagnet,
    fill_truth,
)
from oracles.repetitions import repetitions

OMNI = load("omni")
assert isinstance(OMNI, SphericalElectromagnet)


def weigh(built: ElectromagnetSpecimen, count: int = 40, seed: int = 0, noise: float = 1e-3) -> LoadRecord:
    """Readings of a cell, by filaments: 1 mN and 0.02 mN·m of noise, its zero off, poses 0.05 mm off."""
    rng, truth = np.random.default_rng(seed), built.compute_map(OMNI.dome_radius)
    rows: list[tuple[np.ndarray, ...]] = []
    zero = np.append(0.05 * rng.standard_normal(3), 1e-3 * rng.standard_normal(3))
    for _ in range(count):
        z, turn = rng.uniform(0.5, 1), rng.uniform(0, 2 * np.pi)
        axis = np.array([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
        p, R = rng.uniform(0.05, 0.07) * axis, rotation_to_axis(axis)
        currents, matrix, passive = rng.uniform(-8, 8, 3), np.empty((6, 3)), np.empty(6)
        fill_truth(truth, np.ascontiguousarray(R), p, matrix, passive, np.empty((6, 3)))
        wrench = matrix @ currents + passive + zero + noise * rng.standard_normal(6) * [1, 1, 1, 0.02, 0.02, 0.02]
        rows.append((p + 5e-5 * rng.standard_normal(3), R, currents, wrench))
    return LoadRecord(*(np.array(one) for one in zip(*rows, strict=True)))


def sense(built: ElectromagnetSpecimen) -> Calibration:
    """What the field sensors found before."""
    currents = excitation(OMNI, levels=1, repeats=1)
    fields = compute_fields(built.compute_map(OMNI.dome_radius), OMNI.hall.positions)
    found = magnetic_calibration(OMNI, currents, currents, np.einsum("sim,nm->nsi", fields, currents))
    return Calibration(
        "omni", OMNI.digest, found.moment_per_current, found.uncertainty, found.offsets, OMNI.coils.resistance,
        found.residual, found.condition, found.repeatability, None, True, centres=found.centres,
        centre_uncertainty=found.centre_uncertainty,
    )  # fmt: skip


def find_error(believed: SphericalElectromagnet, built: ElectromagnetSpecimen) -> float:
    """rms of the coils' force over the shell, relative: filaments against the believed model."""
    truth, wrong, whole = built.compute_map(OMNI.dome_radius), 0.0, 0.0
    for n in range(60):
        axis = np.array([np.sin(n) * 0.7, np.cos(n) * 0.7, 1.0])
        axis /= np.linalg.norm(axis)
        state = State.at((0.05 + 0.02 * (n % 7) / 6) * axis, R_SR=rotation_to_axis(axis))
        matrix, passive = np.empty((6, 3)), np.empty(6)
        fill_truth(truth, np.ascontiguousarray(state.R_SR), state.p, matrix, passive, np.empty((6, 3)))
        wrong += float(((matrix[:3] - believed.wrench_map(state, "exact").force) ** 2).sum())
        whole += float((matrix[:3] ** 2).sum())
    return float(np.sqrt(wrong / whole))


def test_forty_readings_halve_what_field_sensors_leave_and_find_the_magnets_strength():
    left, before, deviations = [], [], []
    for specimen in range(repetitions(2, 4)):
        built = draw_electromagnet(OMNI, specimen)
        known = sense(built)
        found, rms = calibrate_by_loads(OMNI, known, weigh(built, seed=specimen))
        assert 0.5e-3 < rms[0] < 3e-3
        before.append(find_error(known.apply(OMNI), built))
        left.append(find_error(found.apply(OMNI), built))
        deviations.append(
            (found.strength * OMNI.tool.remanence / built.ring.remanence - 1) / found.strength_uncertainty
        )
        assert found.strength_uncertainty < 0.5 * OMNI.uncertainty.remanence
        assert Calibration.parse(found.text(), "again").text() == found.text()
    assert np.mean(left) < 0.5 * np.mean(before)
    assert max(left) < 0.01
    assert np.abs(deviations).max() < 3


def write(path: Path, record: LoadRecord, columns: tuple[str, ...] | None = None) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns or list_columns(OMNI))
        for p, R, i, w in zip(record.p, record.R, record.currents, record.wrench, strict=True):
            writer.writerow([*p, *quaternion(R), *i, *w])
    return path


def test_the_command_reads_a_table_and_says_what_it_told(tmp_path, capsys):
    """Forces of the very device that is calibrated in the simulation: specimen and seed 0."""
    table = write(tmp_path / "loads.csv", weigh(draw_electromagnet(OMNI, 0)))
    out = tmp_path / "omni.json"
    with suppress(SystemExit):
        main(["calibrate", "omni", "--steps", "rest,currents,magnetic", "--loads", str(table), "--out", str(out)])
    assert "loads: 40 readings" in capsys.readouterr().err
    text = out.read_text()
    assert '"magnet_strength"' in text
    with suppress(SystemExit):
        main(["inspect", "omni", "--errors", "--calibration", str(out), "--samples", "100", "--json"])
    assert "strength of the magnet" in capsys.readouterr().out


@cache
def good() -> LoadRecord:
    """Fourteen readings that can tell: not made while tests are collected, because every process collects them."""
    return weigh(draw_electromagnet(replace(OMNI, tolerance=None)), 14)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda all: {one: getattr(all, one)[:5] for one in ("p", "R", "currents", "wrench")},
            r"5 readings; at least 12",
        ),
        (lambda all: {"p": np.tile(all.p[:1], (14, 1))}, r"was at 1 places .* measure at 6 or more"),
        (
            lambda all: {"currents": all.currents * [1, 0, 1]},
            r"coil 'y' carries 2 A or more in 0 readings; measure at least 3",
        ),
        (lambda all: {"currents": np.outer(all.currents[:, 0], [1, 1, 1])}, r"currents change together"),
        (lambda all: {"p": 1e3 * all.p}, r"m away; x_m, y_m and z_m are in metres"),
        (lambda all: {"p": 0.3 * all.p}, r"within its core"),
    ],
    ids=["few", "one place", "no y", "together", "millimetres", "in the core"],
)
def test_a_table_that_cannot_tell_is_refused_with_what_to_measure(tmp_path, change, message):
    with pytest.raises(CalibrationError, match=message):
        read_loads(write(tmp_path / "loads.csv", replace(good(), **change(good()))), OMNI)


def test_forces_of_another_device_are_refused():
    turned = replace(good(), wrench=-good().wrench)
    with pytest.raises(CalibrationError, match=r"are not those of device 'omni': .* mN are left; check the frame"):
        calibrate_by_loads(OMNI, sense(draw_electromagnet(replace(OMNI, tolerance=None))), turned)


def test_what_is_no_table_is_refused_by_line(tmp_path):
    short = write(tmp_path / "short.csv", good(), (*list_columns(OMNI)[:-1], "torque"))
    with pytest.raises(CalibrationError, match=r"column tz_nm is missing; a table of loads on 'omni' has x_m"):
        read_loads(short, OMNI)
    words = write(tmp_path / "words.csv", good())
    lines = words.read_text().splitlines()
    lines[3] = lines[3].replace(lines[3].split(",")[0], "here")
    words.write_text("\n".join(lines))
    with pytest.raises(CalibrationError, match=r"words\.csv, line 4: not numbers"):
        read_loads(words, OMNI)
    long = write(tmp_path / "long.csv", replace(good(), R=good().R))
    rows = long.read_text().splitlines()
    cells = rows[1].split(",")
    cells[3:7] = ["2", "0", "0", "0"]
    rows[1] = ",".join(cells)
    long.write_text("\n".join(rows))
    with pytest.raises(CalibrationError, match=r"line 2: qx, qy, qz, qw have length 2 instead of 1"):
        read_loads(long, OMNI)
