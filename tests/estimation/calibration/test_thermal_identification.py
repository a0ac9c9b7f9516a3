"""From a record of heating and cooling to the endurances that the paper prints."""

import numpy as np
import pytest

from haptorb.devices.loader import load
from haptorb.errors import CalibrationError, InputError
from haptorb.estimation.heat_calibration import thermal_identification
from oracles.endurance_fit import endurance_fit

AMBIENT = 298.15
COIL = endurance_fit(60.0)


def record(model, seconds=360, heated=180, watts=17.0, noise=0.0, seed=0, step=0.25):
    """Fig. 6: `heated` seconds of power, then cooling; winding and boundary read with `noise` [K]."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, seconds + step / 2, step)
    power = np.where(t < heated, watts, 0.0)
    rises = np.zeros((len(t), 2))
    for n in range(len(t) - 1):
        rises[n + 1] = model.step(step) @ (*rises[n], power[n])
    noisy = rises + noise * rng.normal(size=rises.shape)
    return t, power, noisy[:, 0] + AMBIENT, noisy[:, 1] + AMBIENT


def test_without_noise_it_is_exact():
    found = thermal_identification(*record(COIL), AMBIENT).model
    assert found.winding_capacity == pytest.approx(COIL.winding_capacity, rel=1e-4)
    assert found.body_to_air == pytest.approx(COIL.body_to_air, rel=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_the_printed_endurances_follow_from_the_record(seed):
    """17 W for ever, full power 5 s, half duty 60 s (Zárate 2020 §III, §V), within 10 % from noisy readings."""
    found = thermal_identification(*record(COIL, noise=0.3, seed=seed), AMBIENT)
    assert found.model.steady_rise(17.0)[0] == pytest.approx(60.0, rel=0.1)
    assert found.endurance(60.0, 240.0) == pytest.approx(5.0, rel=0.1)
    assert found.endurance(60.0, 60.0) == pytest.approx(60.0, rel=0.1)
    assert found.residual == pytest.approx(0.3, rel=0.15)


def test_the_device_file_says_the_same():
    heat = load("omni").coils.heat
    model, rise, alone = heat.network(3), heat.derate - heat.ambient, np.array([0.0, 1.0, 0.0])
    assert model.steady_rise(17.0 * alone)[1] == pytest.approx(rise, rel=0.01)
    assert model.time_to(rise, 240.0 * alone) == pytest.approx(5.0, rel=0.01)
    assert model.time_to(rise, 60.0 * alone) == pytest.approx(60.0, rel=0.01)


def test_a_winding_that_is_only_read_while_it_is_heated_is_enough():
    t, power, winding, boundary = record(COIL, noise=0.2, seed=3)
    winding[t >= 180] = np.nan
    found = thermal_identification(t, power, winding, boundary, AMBIENT)
    assert found.endurance(60.0, 60.0) == pytest.approx(60.0, rel=0.1)


def test_a_short_record_is_refused():
    with pytest.raises(CalibrationError, match="does not determine"):
        thermal_identification(*record(COIL, seconds=40, heated=40, noise=0.3), AMBIENT)


def test_a_lukewarm_record_is_refused():
    with pytest.raises(CalibrationError, match="heat longer"):
        thermal_identification(*record(COIL, watts=0.2), AMBIENT)


def test_a_record_without_a_winding_is_refused():
    t, power, winding, boundary = record(COIL)
    with pytest.raises(CalibrationError, match="fewer than 10"):
        thermal_identification(t, power, np.full_like(winding, np.nan), boundary, AMBIENT)


def test_what_is_no_record():
    t, power, winding, boundary = record(COIL)
    with pytest.raises(InputError, match="rising times"):
        thermal_identification(t[::-1], power, winding, boundary, AMBIENT)
    with pytest.raises(InputError, match="one length"):
        thermal_identification(t[:-1], power, winding, boundary, AMBIENT)
    with pytest.raises(InputError, match="finite"):
        thermal_identification(t, power * np.nan, winding, boundary, AMBIENT)
