"""`haptorb inspect DEVICE --errors`: tables, the same numbers as JSON, a figure, and mistakes in one line."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from haptorb.analysis.array_errors import array_errors
from haptorb.cli.error_report import report_errors
from haptorb.control.array_allocation import array_allocator
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import DeviceError, InputError
from oracles.command import run_command

NARROW = """
based_on = "omni"
name = "narrow"
[uncertainty]
remanence = 0.001
place = { value = "0.05 mm", source = "measured" }
"""


@pytest.fixture(scope="module")
def omni():
    return report_errors(load("omni"), samples=100, asked=0.05)


@pytest.mark.parametrize("width", [80, 120, 50])
def test_the_tables_fit_and_have_every_source(omni, width) -> None:
    out = io.StringIO()
    omni.show(Console(file=out, width=width))
    text = out.getvalue()
    assert all(len(line) <= width for line in text.splitlines())
    for share in omni.budget.shares:
        assert all(word in text for word in share.name.split())
    assert "JND" in text
    assert "mN" in text


def test_the_command_prints_json_with_units_and_draws(omni, capsys, tmp_path) -> None:
    picture = tmp_path / "errors.svg"
    words = ("inspect", "omni", "--errors", "--samples", "100", "--wrench", "50 mN", "--json", "--plot", str(picture))
    code, out, _ = run_command(capsys, *words)
    assert code == 0
    numbers = json.loads(out)
    assert numbers["asked_n"] == pytest.approx(0.05)
    whole = numbers["regions"][-1]
    assert whole["size_jnd"] == pytest.approx(whole["size_n"] / (0.07 * 0.05))
    assert sum(source["first_order"] for source in numbers["sources"]) == pytest.approx(1.0, abs=0.25)
    assert b"</svg>" in picture.read_bytes()
    assert json.loads(json.dumps(omni.numbers())) == numbers  # the same seed


def test_values_of_the_device_file_are_used(tmp_path, omni) -> None:
    path = tmp_path / "narrow.toml"
    path.write_text(NARROW, encoding="utf-8")
    narrow = report_errors(load(path), samples=100, asked=0.05)
    shares = {share.name: share for share in narrow.budget.shares}
    assert shares["remanence"].standard == "0.1 %"
    assert shares["tracked position"].standard == "50 µm"
    wide = {share.name: share for share in omni.budget.shares}
    assert shares["tracked position"].alone == pytest.approx(wide["tracked position"].alone / 6, rel=0.05)
    assert narrow.budget.bands[-1].size < omni.budget.bands[-1].size


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("remanence = -0.01", "uncertainty.remanence must be at least 0"),
        ("remanence = 0.5", "uncertainty.remanence must be at most 0.3"),
        ('place = "3 kg"', "uncertainty.place must be a length"),
        ('place = "2 m"', "uncertainty.place must be at most 5 mm"),
        ("remanense = 0.01", "did you mean 'remanence'"),
        ('current_offset = "nan mA"', "uncertainty.current_offset"),
    ],
)
def test_values_that_cannot_be_are_refused(tmp_path, line, expected) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(f'based_on = "omni"\nname = "bad"\n[uncertainty]\n{line}\n', encoding="utf-8")
    with pytest.raises(DeviceError, match=expected):
        load(path)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["omni", "--wrench", "50 mN"], "belong to --errors"),
        (["omni", "pmsm", "--errors"], "--errors is for one device"),
        (["omni", "--errors", "--wrench", "3 N"], "produces at most"),
        (["omni", "--errors", "--wrench", "3 kg"], "--wrench must be a force"),
        (["omni", "--errors", "--samples", "10"], "--samples must be 100"),
        (["omni", "--errors", "--seed", "-1"], "--seed 0 or more"),
        (["omni", "--errors", "--estimator", "hal"], "did you mean 'hall'"),
        (["omni", "--errors", "--calibration", "no.json"], "no.json"),
        (["pmsm", "--errors", "--estimator", "network"], "estimator"),
    ],
)
def test_a_mistake_of_the_command_is_one_message(capsys, words, expected) -> None:
    code, out, err = run_command(capsys, "inspect", *words)
    assert code == 2
    assert expected in err
    assert not out


@pytest.mark.parametrize("name", [pytest.param("planar", marks=pytest.mark.slow), "tetrahedron"])
def test_a_coil_array_has_a_budget_and_none_without_errors(name) -> None:
    """With a core and without; where nothing is uncertain, what is asked is delivered."""
    device = load(name)
    budget = report_errors(device, samples=100).budget
    shares = {share.name: share for share in budget.shares}
    assert shares["positions of the coils"].alone > 0.0
    assert 0.0 < budget.bands[-1].size < budget.asked
    model = array_errors(device)
    point = model.draw_point(0, np.random.default_rng(0))
    assert np.abs(model.try_error(point, np.zeros(model.dimension))).max() < 1e-6 * model.asked
    with pytest.raises(InputError, match="calibration"):
        array_errors(device, calibration=object())


def test_coils_that_stand_elsewhere_err_as_the_moved_device_does() -> None:
    """The core's answer by its slope against the answer to coils that are really there."""
    device = load("tetrahedron")
    model = array_errors(device)
    point, trial = model.draw_point(0, np.random.default_rng(1)), model.make_trial()
    trial.shift[0], trial.lean[1], trial.turns[2] = (3e-4, -2e-4, 1e-4), (0.004, 0.002, -0.006), 0.02
    windings = device.windings
    axis = windings.axis + np.cross(trial.lean, windings.axis)
    moved = replace(
        windings, position=windings.position + trial.shift, turns=windings.turns * (1 + trial.turns),
        axis=axis / np.linalg.norm(axis, axis=1, keepdims=True),
    )  # fmt: skip
    state = State(0.0, point.R, point.p, np.zeros(3), np.zeros(3))
    known = device.wrench_map(state, "exact")
    currents = array_allocator(device).allocate(known, point.wrench).currents
    there = replace(device, windings=moved).wrench_map(state, "exact")
    expected = point.R.T @ (there.wrench(currents)[:3] - point.wrench[:3])
    assert model.wrench_error(point, trial) == pytest.approx(expected, abs=0.03 * np.linalg.norm(expected))
