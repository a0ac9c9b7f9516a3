"""Force map and other functions of the package: accepted devices, and invalid positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import haptorb
from haptorb import worlds
from haptorb.devices.api import electromagnet
from haptorb.errors import InputError, UnknownName

PLACES = [[0.0, 0.0, 0.055], [0.0, 0.03, 0.05]]
OMNI = Path(haptorb.__file__).parent / "devices/catalogue/omni.toml"


@pytest.mark.parametrize("device", ["omni", str(OMNI), OMNI])
def test_a_device_may_be_its_name_or_its_file(device: str | Path) -> None:
    expected, limited = haptorb.force_map(haptorb.load("omni"), worlds.Dome(), PLACES)
    force, saturated = haptorb.force_map(device, "dome", PLACES)
    assert (force == expected).all()
    assert (saturated == limited).all()
    state = haptorb.State.at(PLACES[0])
    assert (haptorb.wrench_map(device, state).matrix == haptorb.load("omni").wrench_map(state, "exact").matrix).all()
    assert electromagnet(device).name == "omni"


def test_a_motor_may_be_its_file() -> None:
    upright = np.eye(3)
    by_file = haptorb.sensor_field(OMNI.with_name("pmsm.toml"), upright)
    assert (by_file == haptorb.sensor_field("pmsm", upright)).all()


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(UnknownName, match="did you mean 'omni'"):
        haptorb.force_map("omny", "dome", PLACES)
    with pytest.raises(UnknownName, match="did you mean 'dome'"):
        haptorb.force_map("omni", "domo", PLACES)


@pytest.mark.parametrize(
    "call",
    [
        lambda: haptorb.State.at((50.0, 0.0, 0.0)),
        lambda: haptorb.State.at((0.0, 30.0, 40.0), axis=(0, 0, 1)),
        lambda: haptorb.force_map("omni", "dome", [[0.0, 0.0, 0.05], [0.0, 0.0, 55.0]]),
        lambda: haptorb.field("pmsm", np.eye(3), [[0.0, 0.0, 90.0]]),
    ],
)
def test_millimetres_are_refused_with_what_to_write(call) -> None:
    with pytest.raises(InputError, match=r"must be within 1 m of the device's centre; got .* 50 mm are 0\.05"):
        call()


def test_a_metre_is_still_a_place() -> None:
    assert haptorb.State.at((0.0, 0.0, 1.0)).distance == 1.0
