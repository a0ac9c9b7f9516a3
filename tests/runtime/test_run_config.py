"""The description of a run is written into a recording and read from there; what a stranger writes does no harm."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptorb import RunConfig, Servo, load
from haptorb.analysis.coupling import CouplingSetting
from haptorb.analysis.stability import HandGrip
from haptorb.control.linkage import Gains
from haptorb.devices.base import Device
from haptorb.errors import CalibrationError, InputError, RecordingError
from haptorb.estimation.calibration_file import Calibration
from haptorb.estimation.tracker_frame import TrackerFrame
from haptorb.simulation.hand_motion import SampledPath, ScriptedMotion
from haptorb.worlds import find_world
from haptorb.worlds.user_world import WorldFile

OMNI, PMSM = load("omni"), load("pmsm")
HAND = ScriptedMotion(SampledPath([(0.0, 0.0, 0.06), (0.0, 0.0, 0.05)], [0.0, 1.0]), name="a.hand", digest="0" * 64)
FRAME = TrackerFrame(
    "omni", OMNI.digest, "osc:9000", False, np.eye(3), np.array([0.1, 0.0, 0.2]), np.zeros(3),
    np.array([0.0, 0.0, 0.01]), np.array([0.0, 0.0, 1.0]), 1e-4, 3.0, 1e-4, 1e-3,
)  # fmt: skip

#: another value than the default for every field but device and world, which `from_notes` is given
OTHER: Mapping[str, Any] = {
    "driver": "serial:/dev/ttyACM0",
    "tracker": "osc:9000",
    "prediction": 0.0123,
    "frame": FRAME,
    "rate": 1234.5,
    "seed": 2**70,
    "model": OMNI.tick_models[-1],
    "estimator": "hall",
    "gains": Gains(translate=(0.1, 0.2, 0.3)),
    "calibration": Calibration(
        "omni", OMNI.digest, 0.2 * np.eye(3), np.eye(3), np.zeros((9, 3)), np.ones(3), 0.0, 1.0, 0.0, None, True
    ),
    "watchdog": False,
    "render": "both",
    "torque_arm": 0.031,
    "learned": b"trained",
    "coupling": CouplingSetting(OMNI, 900.0, HandGrip(0.2, 3.0, 50.0), "hall", True, 0.004),
    "world_file": WorldFile(Path("groove.py"), "Groove"),
    "hand": HAND,
    "hand_start": "program",
}  # fmt: skip
LOST = {"world_file": None, "hand": None}  #: fields that a recording does not contain


def read_again(config: RunConfig, **changes: str) -> RunConfig:
    run = json.loads(json.dumps(config.notes()["run"])) | changes
    return RunConfig.from_notes(config.device, config.world, run, "a.mcap")


def assert_same(one: Any, other: Any) -> None:
    if isinstance(one, TrackerFrame | Calibration):
        one, other = one.text(), other.text()
    assert one == other


def make(device: Device = OMNI, **changes: Any) -> RunConfig:
    return RunConfig(device=device, world=find_world(device.kind.world)(), **changes)


@pytest.mark.parametrize("name", [one.name for one in fields(RunConfig) if one.name not in ("device", "world")])
def test_every_field_comes_back(name: str) -> None:
    usual = make()
    config = replace(usual, **{name: OTHER[name]})
    assert getattr(usual, name) != OTHER[name]
    assert_same(LOST.get(name, OTHER[name]), getattr(read_again(config), name))


@pytest.mark.parametrize("device", [OMNI, PMSM])
def test_a_checked_description_comes_back_whole(device: Device) -> None:
    config = RunConfig.of(device, grip="firm", seed=3, rate=800)
    again = read_again(config)
    for field in fields(RunConfig):
        assert_same(getattr(config, field.name), getattr(again, field.name))


def test_a_recording_without_texts_has_the_defaults() -> None:
    assert RunConfig.from_notes(OMNI, make().world, {}, "a.mcap") == make()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("driver", "\x1b[2J"), ("driver", "i2c2:1"), ("driver", "serial:" + "x" * 10_000), ("tracker", "mouse"),
        ("tracker", "osc:\n9000"), ("tracker", "osc"), ("prediction_s", "nan"), ("prediction_s", "3"), ("seed", "-1"),
        ("seed", "9" * 10_000), ("seed", "1.5"), ("seed", "\u0664"), ("rate_hz", "-inf"), ("rate_hz", "0"),
        ("rate_hz", "1e-300"), ("rate_hz", "1e9"),
        ("watchdog", "off"), ("torque_arm_m", "1e999"), ("learned", "\u00e9"), ("hand_start", "now"),
        ("gains", "[" * 100_000), ("coupling", "[1]"),
    ],
)  # fmt: skip
def test_foreign_texts_give_the_default(name: str, text: str) -> None:
    assert RunConfig.from_notes(OMNI, make().world, {name: text}, "a.mcap") == make()


COUPLING: dict[str, Any] = {
    "rate_hz": 1e3, "mass_kg": 0.1, "damping_n_s_per_m": 1.0, "stiffness_n_per_m": 1.0, "estimator": "tracker",
    "fed": False, "latency_s": None,
}  # fmt: skip


@pytest.mark.parametrize(
    "change",
    [
        {"rate_hz": "fast"}, {"rate_hz": 1e9}, {"mass_kg": -1.0}, {"mass_kg": None}, {"mass_kg": 10**400},
        {"mass_kg": 1e-300, "damping_n_s_per_m": 1e300},
        {"stiffness_n_per_m": float("nan")}, {"estimator": 3}, {"estimator": ""}, {"fed": 1}, {"latency_s": 1e3},
    ],
)  # fmt: skip
def test_a_foreign_coupling_is_refused(change: dict[str, Any]) -> None:
    assert read_again(make(), coupling=json.dumps(COUPLING)).coupling is not None
    with pytest.raises(RecordingError, match=r"a\.mcap.*coupling"):
        read_again(make(), coupling=json.dumps(COUPLING | change))


def test_a_foreign_frame_or_part_is_refused() -> None:
    with pytest.raises(CalibrationError, match=r"a\.mcap"):
        read_again(make(), frame="{}")
    with pytest.raises(RecordingError, match=r"a\.mcap.*torqe"):
        read_again(make(), render="torqe")


def test_reading_a_description_opens_nothing(tmp_path: Path) -> None:
    """Port, address and files that a recording names are not touched, not even looked for."""
    mapping = tmp_path / "a.toml"
    for tracker in ("natnet:192.0.2.1", f"replay:{tmp_path / 'no.mcap'}", f"osc:9000,{mapping}"):
        again = read_again(make(), driver="serial:/dev/nothing", tracker=tracker)
        assert (again.driver, again.tracker) == ("serial:/dev/nothing", tracker)
    assert again.simulated().driver == "sim"


def test_a_servo_has_the_settings_of_a_description() -> None:
    """Same names and defaults; what only a servo or only `haptorb run` has is listed."""
    of = dict(inspect.signature(RunConfig.of).parameters)
    servo = dict(inspect.signature(Servo).parameters)
    assert set(servo) - set(of) == {"record", "overwrite", "black_box", "about"}
    assert set(of) - set(servo) == {"hand_start"}
    for name in set(of) & set(servo):
        assert of[name].default == servo[name].default
    with pytest.raises(InputError, match="rate, grip"):
        Servo(RunConfig.of("omni"), rate=500.0, grip="firm")
