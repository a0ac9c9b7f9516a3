"""Kinds of device are distinguished by registration only: no other code in `src` tests for the class."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from haptorb.analysis.coupling import hold_mover
from haptorb.analysis.error_models import error_model
from haptorb.analysis.workspace import workspace
from haptorb.cli.cards import card
from haptorb.cli.check_world import boundary
from haptorb.control.linkage import make_linkage
from haptorb.control.registry import describe_choice, has_choice, make_allocator, make_choice
from haptorb.devices.api import electromagnet, motor
from haptorb.devices.base import Device
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.devices.motor import SphericalMotor
from haptorb.devices.registry import REGISTERED, kind_of_name
from haptorb.errors import InputError
from haptorb.estimation.registry import list_estimators
from haptorb.simulation.hand_motion import guide_hand
from haptorb.simulation.registry import simulate
from haptorb.web.session import describe_scene
from oracles.command import run_command

CLASSES = (SphericalElectromagnet, SphericalMotor, CoilArray)


@pytest.mark.parametrize("name", ["omni", "pmsm", "planar"])
def test_every_function_answers_for_every_kind(name: str) -> None:
    device = load(name)
    assert make_allocator(device).allocate
    assert (make_choice(device) is not None) == has_choice(device) == (name != "pmsm")
    assert make_linkage(device).modes == device.kind.modes
    assert "tracker" in list_estimators(device)
    assert guide_hand(device).at(0.0)[0].shape == (3,)
    assert simulate(device, 3).device is device
    assert describe_scene(device)["kind"] in ("dome", "motor", "plate")
    assert workspace(device).places.shape[1] == 3
    assert device.geometry() is not None


@pytest.mark.parametrize(
    "function",
    [make_allocator, make_choice, describe_choice, make_linkage, list_estimators, guide_hand, simulate, describe_scene,
     workspace, hold_mover, error_model, card, boundary],
    ids=lambda one: one.__name__,
)  # fmt: skip
def test_only_classes_of_devices_are_registered(function: Any) -> None:
    assert set(function.registry) <= {object, *CLASSES} | {one for one in function.registry if issubclass(one, Device)}
    assert any(one in function.registry for one in CLASSES)


def test_a_device_names_its_kind() -> None:
    assert load("omni").kind is kind_of_name("spherical-electromagnet")
    assert load("pmsm").kind is kind_of_name("spherical-motor")


def test_a_program_for_one_kind_says_so() -> None:
    with pytest.raises(InputError, match="'pmsm' is a spherical motor; `haptorb calibrate` works for spherical elec"):
        electromagnet(load("pmsm"), "`haptorb calibrate`")
    with pytest.raises(InputError, match=r"'omni' is a spherical electromagnet; .* works for spherical motors"):
        motor("omni")


def test_nothing_else_asks_for_the_class_of_a_device(root: Path) -> None:
    asks = re.compile(r"(?:isinstance|issubclass)\([^)]*Spherical|\bcase Spherical|type\(device\)")
    found = [
        f"{path.relative_to(root)}: {line.strip()}"
        for path in sorted((root / "src").rglob("*.py"))
        for line in path.read_text(encoding="utf-8").splitlines()
        if asks.search(line)
    ]
    assert found == []


SCRIPT = """
import sys
from dataclasses import dataclass, fields
from typing import ClassVar
from haptorb import load
from haptorb.control.allocation import LeastSquaresAllocator
from haptorb.control.registry import make_allocator
from haptorb.devices import DeviceKind
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.runtime import plan
from haptorb.runtime.config import RunConfig
from haptorb.devices.base import own_implementations
from haptorb.worlds import Nothing
from pathlib import Path

@dataclass(frozen=True, kw_only=True)
class Mine(SphericalElectromagnet):
    kind: ClassVar[DeviceKind] = DeviceKind(name="mine", title="device of a script", world="nothing")

@make_allocator.register(Mine)
def allocate_half(device):
    return LeastSquaresAllocator.force(0.5 * device.coils.current_limit)

omni = load("omni")
mine = Mine(**{one.name: getattr(omni, one.name) for one in fields(omni)})
config = RunConfig(device=mine, world=Nothing())
plan.save(plan.Plan(config, {}, own_implementations(mine)), Path(sys.argv[1]))
"""
READER = """
import sys
from pathlib import Path
from haptorb.control.registry import make_allocator
from haptorb.runtime import plan
device = plan.load(Path(sys.argv[1])).config.device
print(type(device).__name__, make_allocator(device).limits.tolist() if hasattr(make_allocator(device), "limits")
      else make_allocator.dispatch(type(device)).__name__)
"""


def test_a_kind_that_a_script_defines_reaches_the_process_of_the_loop_with_its_implementations(tmp_path: Path) -> None:
    script = tmp_path / "mine.py"
    script.write_text(SCRIPT)
    subprocess.run([sys.executable, str(script), str(tmp_path / "plan")], check=True, timeout=120)
    read = subprocess.run(
        [sys.executable, "-c", READER, str(tmp_path / "plan")], check=True, timeout=120, capture_output=True, text=True
    )
    assert read.stdout.split() == ["Mine", "allocate_half"]


RAIL = Path(__file__).resolve().parents[1] / "rail"


def test_a_kind_of_an_installed_package_is_known_to_the_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    info = tmp_path / "rail_of_a_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: rail-of-a-package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[haptorb.kinds]\nrail = rail_of_a_package:RAIL\nbroken = rail_of_a_package:NOTHING\n"
        "plain = rail_of_a_package:PLAIN\n"
    )
    plain = 'PLAIN = DeviceKind(name="plain", title="device made in Python", world="nothing")\n'
    (tmp_path / "rail_of_a_package.py").write_text((RAIL / "rail.py").read_text(encoding="utf-8") + plain)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(REGISTERED, "rail", raising=False)
    assert load(RAIL / "rail.toml").kind.title == "magnet on a rail"
    code, said, error = run_command(capsys, "keys", "device")
    assert code == 0
    assert "kind of device 'broken' (rail_of_a_package:NOTHING) cannot be loaded" in error
    assert "rail.hand_stiffness" in said
    assert "plain" not in said + error  # it has no file
    broken = tmp_path / "broken.toml"
    broken.write_text((RAIL / "rail.toml").read_text(encoding="utf-8").replace('kind = "rail"', 'kind = "broken"'))
    code, _, error = run_command(capsys, "inspect", str(broken))
    assert code == 2
    assert "kind of device 'broken' (rail_of_a_package:NOTHING) cannot be loaded" in error
