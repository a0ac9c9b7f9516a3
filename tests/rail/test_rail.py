"""A kind of device defined by this test runs like a built-in one, without a change in `src`."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import httpx
import numpy as np
import pytest

import haptorb
from haptorb import DeviceError, InputError, Recording, Servo, State, UnknownName
from haptorb.control.linkage import Gains
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices import DeviceKind, parse_device, register_kind
from haptorb.kinds import card
from haptorb.web.console import Console


def run(servo: Servo, seconds: float, p: tuple[float, float, float] | None = None) -> Any:
    """Let the loop run with the hand held at `p`; the last 50 rows."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        servo.check()
        if p is not None:
            servo.hand.point(p)
        time.sleep(0.01)
    return servo.rows()[1][-50:]


def test_its_file_is_read(rail: ModuleType, rail_file: Path):
    device = haptorb.load(rail_file)
    assert type(device) is rail.Rail
    assert device.kind is rail.RAIL
    assert device.coils.names == ("left", "right")
    force = device.wrench_map(State.at((0.0, 0.0, 0.0), (0, 0, 1)), "ring").matrix
    assert force[0, 0] == pytest.approx(-force[0, 1])
    assert force[0, 1] > 0.01  # the right coil pulls to the right
    assert not force[1:].any()
    wrong = rail_file.read_text().replace('"100 g"', '"100 m"')
    with pytest.raises(DeviceError, match=r"rail\.mass must be a mass"):
        parse_device(wrong, "rail")


def test_its_model_agrees_with_the_energy_of_its_magnet(rail: ModuleType, rail_file: Path):
    device = haptorb.load(rail_file)
    x, h = 0.011, 1e-5

    def field(x: float, c: float) -> float:
        return rail.MU0 * device.turns * device.radius**2 / (2 * (device.radius**2 + (x - c) ** 2) ** 1.5)

    for n, c in enumerate((-device.distance, device.distance)):
        slope = device.moment * (field(x + h, c) - field(x - h, c)) / (2 * h)
        assert device.per_ampere(x)[n] == pytest.approx(slope, rel=1e-6)


@pytest.mark.realtime
@pytest.mark.usefixtures("quick_starts")
def test_it_runs_is_recorded_and_stops(rail: ModuleType, rail_file: Path, tmp_path: Path):
    path = tmp_path / "rail.mcap"
    with Servo(rail_file, record=path, rate=500.0) as servo:
        assert (servo.world[0], servo.estimator, servo.modes) == ("wall", "tracker", ())
        at = servo.layout
        outside = run(servo, 1.0, (0.012, 0.0, 0.0))
        assert outside[-1, at["p"]] == pytest.approx([0.012, 0, 0], abs=5e-4)
        assert np.abs(outside[:, at["current_commanded"]]).max() < 1e-9
        inside = run(servo, 1.0, (-0.003, 0.0, 0.0))
        last = inside[-1]
        assert last[at["guard"]][0] == GuardState.RUNNING, Trip(int(last[at["trip"]][0])).text
        assert -0.003 < last[at["p"]][0] < -0.0005  # the wall holds against the hand
        assert last[at["wrench_commanded"]][0] > 0.05
        assert last[at["wrench_actual"]][0] == pytest.approx(last[at["wrench_commanded"]][0], rel=0.1)
        assert not last[at["wrench_actual"]][1:].any()
        assert last[at["current_measured"]] == pytest.approx(last[at["current_commanded"]], abs=0.05)
        assert (
            last[at["current_measured"]][1] > 0.1 > -0.1 > last[at["current_measured"]][0]
        )  # one pulls, the other pushes
        servo.stop()
        stopped = run(servo, 0.3, (-0.003, 0.0, 0.0))
        assert (stopped[:, at["guard"]] == GuardState.TRIPPED).all()
        assert not stopped[:, at["duty_applied"]].any()
        assert np.abs(stopped[-1, at["current_measured"]]).max() < 0.05
        servo.engage()
        again = run(servo, 1.0, (-0.003, 0.0, 0.0))
        assert again[-1, at["wrench_actual"]][0] > 0.05
    recording = Recording(path)
    assert recording.layout == at
    assert recording.metadata["device"]["name"] == "rail"
    assert recording.metadata["device"]["file"] == rail_file.read_text()
    assert recording["current_measured"].shape[1] == 2
    assert np.nanmax(recording["wrench_actual"][:, 0]) > 0.05


@pytest.mark.realtime
@pytest.mark.usefixtures("quick_starts")
def test_the_console_shows_it(rail: ModuleType, rail_file: Path):
    servo = Servo(rail_file, record=False, rate=500.0)
    with Console(servo, 0) as console, servo:
        serving = threading.Thread(target=console.serve)
        serving.start()
        try:
            told = httpx.get(
                f"{console.origin}/api/session", headers={"Authorization": f"Bearer {console.token}"}
            ).json()
        finally:
            console.close()
            serving.join(10)
    assert told["scene"] == {"gives": "force", "kind": "rail", "rest": [0.0, 0.0, 0.0], "travel": 0.03}
    assert told["coils"] == ["left", "right"]
    assert told["modes"] == []
    names = {world["name"] for world in told["worlds"]}
    assert "wall" in names
    assert "dome" not in names  # it has none
    assert told["world"]["name"] == "wall"


def test_what_it_does_not_say_is_refused_in_words(rail: ModuleType, rail_file: Path):
    device = haptorb.load(rail_file)
    with pytest.raises(InputError, match=r"magnet on a rail; `haptorb inspect` works for .*spherical electromagnets"):
        card(device)
    with pytest.raises(InputError, match="world 'dome' is for a tool over a sphere; device 'rail' has none"):
        Servo(device, "dome")
    with pytest.raises(UnknownName, match="estimator of device 'rail'"):
        Servo(device, estimator="hall")
    with pytest.raises(InputError, match="'rail' has no modes"):
        Servo(device, gains=Gains())
    other = DeviceKind(name="rail", title="another rail", world="wall")
    with pytest.raises(InputError, match="there is a kind of device 'rail' already"):
        register_kind(other)
