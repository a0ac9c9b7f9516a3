"""Evaluation of a candidate: rejected with a reason, or computed; identical in every process."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cloudpickle
import pytest

from haptorb_design.evaluate import evaluate
from haptorb_design.problem import Design, Value
from haptorb_design.search_space import measure_violation
from oracles.designs.small_design import CODE, TEXT, make_design

GOOD: dict[str, Value] = {"radius": 30.0, "angle": 60.0, "shell": "thick"}


def test_a_valid_candidate_has_all_numbers(tmp_path: Path) -> None:
    found = evaluate(make_design(tmp_path), 7, GOOD)
    assert found.valid, found.reason
    assert (found.number, found.values, found.refused_by, found.reason) == (7, GOOD, "", "")
    assert found.objectives == pytest.approx({"cost": 0.032, "reach": 1.0471975512})
    assert found.constraints == pytest.approx({"room": 0.030})


def test_a_broken_constraint_refuses_before_objectives_are_computed(tmp_path: Path) -> None:
    found = evaluate(make_design(tmp_path), 0, {**GOOD, "radius": 31.5})
    assert (found.refused_by, found.objectives) == ("room", {})
    assert found.constraints == pytest.approx({"room": 0.0315})
    assert "above" in found.reason


def test_values_that_make_no_device(tmp_path: Path) -> None:
    design = make_design(tmp_path, TEXT.replace('low = "26 mm"', 'low = "12 mm"'))
    found = evaluate(design, 0, {**GOOD, "radius": 14.0})
    assert found.refused_by == "device"
    assert "\n" not in found.reason
    assert found.reason


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("return float('nan')", "nan"),
        ("return float('inf')", "inf"),
        ("return 1 / 0", "ZeroDivisionError"),
        ("return 'much'", "ValueError"),
        ("return None", "TypeError"),
        ("raise MemoryError('lots')", "MemoryError: lots (own.py, line"),
    ],
)
@pytest.mark.parametrize("name", ["cost", "room"])
def test_a_function_without_a_number_refuses_the_candidate(tmp_path: Path, body: str, reason: str, name: str) -> None:
    code = CODE.replace(f"def {name}(candidate):", f"def {name}(candidate):\n    {body}")
    found = evaluate(make_design(tmp_path, code=code), 0, GOOD)
    assert found.refused_by == {"cost": "objective", "room": "room"}[name]
    assert reason in found.reason
    assert found.objectives == {}


def test_the_base_device_keeps_its_own_bounds(tmp_path: Path) -> None:
    design = make_design(tmp_path, TEXT.replace('at_most = "31 mm"', 'at_most = "base"\nat_least = "base"'))
    assert evaluate(design, 0, GOOD).valid


def test_a_design_travels_with_its_functions(tmp_path: Path) -> None:
    (tmp_path / "beside_small.py").write_text("TENTH = 0.1\ndef add(radius, more):\n    return radius + TENTH * more\n")
    code = "from beside_small import add\nimport beside_small\n" + CODE.replace(
        "candidate.device.shell.dome_radius + 0.1 * candidate.device.shell.thickness",
        "add(candidate.device.shell.dome_radius, 10 * beside_small.TENTH * candidate.device.shell.thickness)",
    )
    design = make_design(tmp_path, code=code)
    packed = cloudpickle.dumps(design)
    for file in tmp_path.glob("*.*"):
        file.unlink()
    program = (
        "import sys, cloudpickle, json; from haptorb_design.evaluate import evaluate;"
        "d = cloudpickle.loads(sys.stdin.buffer.read());"
        f"print(json.dumps(dict(evaluate(d, 0, {GOOD}).objectives)))"
    )
    out = subprocess.run([sys.executable, "-c", program], input=packed, capture_output=True, check=True).stdout
    assert eval(out) == evaluate(design, 0, GOOD).objectives
    assert isinstance(design, Design)


def test_a_device_that_cannot_be_built_names_the_condition_and_is_the_nearer_the_less_it_misses(tmp_path: Path) -> None:
    """Windings 0.3 and 2.3 mm too far out for the dome; behind both come values that form no device at all."""
    text = TEXT.replace('"bare.toml"', '"omni"').replace('low = "26 mm"', 'low = "12 mm"')
    design = make_design(tmp_path, text)
    near, far, none = (evaluate(design, 0, {**GOOD, "radius": radius}) for radius in (29.4, 27.4, 14.0))
    assert near.refused_by == far.refused_by == "build: windings inside the dome"
    assert "28.44 mm" in near.reason
    assert "at most 27.9 mm is possible" in near.reason
    assert none.refused_by == "device"
    misses = [measure_violation(one, design.bounds) for one in (near, far, none)]
    assert len(design.bounds) < misses[0] < misses[1] < misses[2] == len(design.bounds) + 1
