"""The model that the controller inverts, and its replacement without a step."""

import numpy as np
import pytest

from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import InputError, UnknownName
from haptorb.estimation.controller_model import FADE, ControllerModel

OMNI = load("omni")
DT = 1e-3


def at(n: int) -> State:
    state = State.at((0.01, 0.0, 0.052))
    return State(n * DT, state.R_SR, state.p, state.w, state.v)


def test_the_default_is_the_exact_one():
    model = ControllerModel(OMNI)
    assert model.name == "exact"
    assert (model.wrench_map(at(0)).matrix == OMNI.wrench_map(at(0), "exact").matrix).all()
    with pytest.raises(UnknownName, match="did you mean 'published'"):
        model.change("publishd")
    assert model.name == "exact"


@pytest.mark.parametrize("again", [(), (20,), (20, 30)], ids=["once", "and back on the way", "to and fro"])
def test_another_one_takes_over_in_small_parts(again):
    model, n = ControllerModel(OMNI), 5
    ends = {name: OMNI.wrench_map(at(0), name) for name in OMNI.models}
    whole = np.abs(ends["exact"].matrix - ends["published"].matrix).max()
    maps = []
    for n in range(200):
        if n == 5 or n in again:
            model.change("published" if model.name == "exact" else "exact")
        maps.append(model.wrench_map(at(n)))
    steps = np.abs(np.diff([m.matrix for m in maps], axis=0)).max(axis=(1, 2))
    assert steps.max() <= 1.001 * whole * DT / FADE
    assert (steps > 0).any()
    assert maps[4].matrix == pytest.approx(ends["exact"].matrix)
    assert maps[-1].matrix == pytest.approx(ends[model.name].matrix)
    assert maps[-1].passive == pytest.approx(ends[model.name].passive)
    currents = np.array([3.0, -2.0, 5.0])
    pulls = np.array([m.wrench(currents) for m in maps])
    both = np.array([ends[name].wrench(currents) for name in ("exact", "published")])
    assert (pulls >= both.min(axis=0) - 1e-12).all()
    assert (pulls <= both.max(axis=0) + 1e-12).all()


def test_a_clock_that_stands_still_changes_nothing():
    model = ControllerModel(OMNI)
    model.wrench_map(at(0))
    model.change("published")
    first = model.wrench_map(at(1))
    assert (model.wrench_map(at(1)).matrix == first.matrix).all()


def test_a_servo_takes_what_fits_into_a_tick():
    assert OMNI.check_tick_model("published") == "published"
    motor = load("pmsm")
    assert motor.check_tick_model("table") == "table"
    with pytest.raises(InputError, match=r"takes too long for a tick; a servo can use: table"):
        motor.check_tick_model("published")
    with pytest.raises(UnknownName, match=r"unknown model of device 'pmsm': 'tabel'; did you mean 'table'"):
        motor.check_tick_model("tabel")
