"""`haptorb estimators --sensors`: effect of each error of a motor's field sensors on orientation and torque."""

from dataclasses import replace

import numpy as np
import pytest

from haptorb.cli import main
from haptorb.cli.sensing_accuracy import sensing_accuracy
from haptorb.devices.loader import load
from haptorb.errors import InputError
from haptorb_papers.estimators import find_effects

SMALL = {"orientations": 12, "devices": 2}


def test_every_error_has_its_effect_and_a_greater_one_a_greater():
    motor = load("pmsm")
    found = find_effects(motor, **SMALL)
    none = found.row("none")
    assert np.degrees(none.orientation) < 1e-4
    for name in ("noise", "offset", "gain", "cross", "placement", "angle", "drift"):
        assert found.row(name).orientation > 3 * none.orientation
        assert found.row(name).refused == 0.0
    assert found.row("one dead").orientation < found.row("offset").orientation  # it is found and left out
    assert found.row("all errors, cold").torque > found.row("noise").torque
    coarse = replace(motor.hall.errors, placement=10 * motor.hall.errors.placement)
    worse = find_effects(replace(motor, hall=replace(motor.hall, errors=coarse)), **SMALL)
    assert worse.row("placement").orientation == pytest.approx(10 * found.row("placement").orientation, rel=0.5)


def test_options_that_mean_nothing_here_are_refused(capsys):
    assert main(["estimators", "pmsm", "--sensors", "--plot", "a.png"]) != 0
    assert "leave out --plot" in capsys.readouterr().err
    with pytest.raises(InputError, match="spherical motor"):
        sensing_accuracy(load("pmsm"))
