"""pyOpenHaptics and forcedimension-core as published, on a motor in both modes and on a coil array."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np
import pytest

from haptorb.testing import haptic_device, scripted_hand

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

OPENHAPTICS = """
import json, time
from pyOpenHaptics.hd_device import HapticDevice
from pyOpenHaptics.hd_callback import hd_callback
import pyOpenHaptics.hd as hd

places, buttons = [], []

@hd_callback
def callback():
    places.append([float(one) for one in hd.get_transform()[3][:3]])
    hd.set_force([0.2, 0.3, 0.4])
    buttons.append(hd.get_buttons())

device = HapticDevice(callback=callback, device_name="Default Device", scheduler_type="async")
print("open", flush=True)
while 0b010 not in buttons:
    time.sleep(0.01)
name = hd.get_model()
device.close()
print(json.dumps([name, places[-1], sorted(set(buttons))]))
"""

FORCE_DIMENSION = """
import json, time
from forcedimension_core import dhd
import forcedimension_core.dhd.expert as expert

assert dhd.open() == 0
expert.setTimeGuard(0)
p, f, answers, buttons = [0.0] * 3, [0.0] * 3, set(), set()
print("open", flush=True)
while 0b010 not in buttons:
    dhd.getPosition(p)
    answers.add(dhd.setForce([0.2, 0.3, 0.4]))
    dhd.getForce(f)
    buttons.add(dhd.getButtonMask())
    time.sleep(0.001)
print(json.dumps([dhd.getSystemName(), p, sorted(buttons), sorted(answers), f, dhd.close()]))
"""


def run_program(run: Any, libraries: Path, tmp_path: Path, source: str, act: Callable[[], None]) -> list[Any]:
    """The program's last line; `act` while it commands, then button b ends it."""
    kit = tmp_path / "sdk/lib/release"
    if not kit.exists():
        kit.mkdir(parents=True)
        (kit / f"lin-{os.uname().machine}-gcc").symlink_to(libraries)
    address = next(line for line in run._serving.lines if line.startswith("native: ")).removeprefix("native: ")
    environment = {
        **os.environ, "FDSDK": str(tmp_path / "sdk"), "LD_LIBRARY_PATH": str(libraries), "HAPTORB_RUN": address,
    }  # fmt: skip
    with subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", source], env=environment, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            while process.stdout.readline() != "open\n":
                assert process.poll() is None
            run.play(0.8)
            act()
            run.servo.press(["b"])
            out = process.communicate(timeout=30)[0]
        finally:
            process.kill()
    run.servo.press([])
    assert process.returncode == 0
    end = monotonic() + 5.0
    while any(one["end_s"] is None for server in run.servo.connections for one in server["programs"]):
        assert monotonic() < end
        sleep(0.01)
    return list(json.loads(out.splitlines()[-1]))


def need(*packages: str) -> None:
    for one in packages:
        if find_spec(one) is None:
            pytest.skip(f"{one} is not installed")


def test_both_packages_on_an_array_of_coils(libraries: Path, tmp_path: Path) -> None:
    """One after the other: the force in each one's frame, buttons, and the device is given back."""
    need("pyOpenHaptics", "forcedimension_core")
    with haptic_device("planar", real_time=True, serve=["native"]) as run:
        first = run_program(run, libraries, tmp_path, FORCE_DIMENSION, lambda: None)
        second = run_program(run, libraries, tmp_path, OPENHAPTICS, lambda: None)
        holds = run.servo.connections[0]["programs"]
    name, _, buttons, answers, force, closed = first
    assert (name, buttons, answers, closed) == ("haptorb planar", [0, 2], [0], 0)
    assert force == pytest.approx([0.2, 0.3, 0.4], abs=1e-6)
    assert second[::2] == ["haptorb planar", [0, 2]]
    assert np.isfinite(second[1]).all()
    assert [one["end"] for one in holds] == ["released", "released"]
    t, asked = np.asarray(run.recording["t"]), np.asarray(run.recording["wrench_commanded"])[:, :3]
    # x towards the user, y right, z up; x right, y up, z towards the user. The stator's y points away from the user.
    for hold, wanted in zip(holds, ((0.3, -0.2, 0.4), (0.2, -0.4, 0.3)), strict=True):
        held = (t > hold["start_s"] + 0.2) & (t < hold["end_s"] - 0.1)
        assert np.median(asked[held], axis=0) == pytest.approx(wanted, abs=1e-6)
        after = (t > hold["end_s"] + 0.03) & (t < hold["end_s"] + 0.05)
        assert (asked[after] == 0.0).all()


def test_openhaptics_on_a_motor(libraries: Path, tmp_path: Path) -> None:
    """In mode translate the force on the object is rendered; in mode rotate a force has no share, and none is felt."""
    need("pyOpenHaptics")
    with haptic_device("pmsm", hand=scripted_hand("start turn 0 0 0 °"), real_time=True, serve=["native"]) as run:
        changed = []

        def rotate() -> None:
            changed.append(run.t)
            run.servo.set_mode("rotate")
            run.play(0.8)
            changed.append(run.t)

        name, place, buttons = run_program(run, libraries, tmp_path, OPENHAPTICS, rotate)
    assert (name, buttons) == ("haptorb pmsm", [0, 2])
    assert np.isfinite(place).all()
    rows = run.recording
    t, share, wrench = (np.asarray(rows[one]) for one in ("t", "clutch_share", "object_wrench"))
    torque = np.asarray(rows["wrench_commanded"])[:, 3:]
    pushed = (t > changed[0] - 0.3) & (t < changed[0])
    assert np.median(wrench[pushed], axis=0) == pytest.approx([0.2, -0.4, 0.3, 0.0, 0.0, 0.0], abs=1e-6)
    assert (share[pushed] == [1.0, 0.0]).all()
    assert np.abs(np.median(torque[pushed], axis=0)).max() > 1e-3, "a force on the object is a torque of the rotor"
    turned = (t > changed[1] - 0.2) & (t < changed[1])
    assert (share[turned] == [0.0, 1.0]).all()
    assert np.abs(np.median(torque[turned], axis=0)).max() < 1e-4
