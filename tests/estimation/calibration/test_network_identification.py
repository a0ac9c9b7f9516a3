"""Identification of thermal coupling between coils, and records that do not determine it."""

from dataclasses import replace

import numpy as np
import pytest

from haptorb.devices.base import HeatCoupling
from haptorb.devices.loader import load
from haptorb.errors import CalibrationError, InputError
from haptorb.estimation.heat_calibration import HeatRecord, network_identification
from haptorb.thermal import ThermalNetwork, TwoNode

OMNI = load("omni")
NAMES, HEAT = OMNI.coils.names, OMNI.coils.heat
TRUE, COUPLING = TwoNode(14.0, 45.0, 1.2, 0.13), HeatCoupling(60.0, (0.7, 0.4, 0.3))
AMBIENT, WARM = 298.15, 0.6


def record(driven=(0, 1, 2), heated=180, cooled=180, watts=20.0, noise=0.1, small=WARM, always=None):
    """Each coil of `driven` in turn for `heated` seconds, then `cooled` seconds; a small power in all the time."""
    power = np.full((heated * len(driven) + cooled, 3), small)
    for n, coil in enumerate(driven):
        power[n * heated : (n + 1) * heated, coil] = watts
    if always is not None:
        power[:, always] = watts
    step = ThermalNetwork.of_coils(TRUE, COUPLING.winding_to_core, COUPLING.core_capacity).step(1.0)
    rises = np.zeros((len(power), 7))
    for n in range(len(power) - 1):
        rises[n + 1] = step @ [*rises[n], *power[n]]
    noisy = AMBIENT + rises + noise * np.random.default_rng(0).normal(size=rises.shape)
    return HeatRecord(np.arange(len(power), dtype=float), power, noisy[:, :3], noisy[:, 3:6], AMBIENT)


def test_every_value_is_found_and_what_follows_from_them():
    """The file's values, from which the search begins, are up to 60 % off."""
    found = network_identification(record(), NAMES, HEAT)
    for name in ("winding_capacity", "body_capacity", "winding_to_body", "body_to_air"):
        assert getattr(found.model, name) == pytest.approx(getattr(TRUE, name), rel=0.03)
    assert found.coupling.core_capacity == pytest.approx(60.0, rel=0.1)
    assert found.coupling.winding_to_core == pytest.approx(COUPLING.winding_to_core, rel=0.05)
    assert found.residual == pytest.approx(0.1, rel=0.1)
    assert (found.uncertainty < 0.05).all()
    # an independent measure of the coupling: what one coil's power does to the others in the end
    models = [(found.model, found.coupling), (TRUE, COUPLING)]
    steady = [ThermalNetwork.of_coils(a, b.winding_to_core, b.core_capacity).rise_per_watt for a, b in models]
    assert np.allclose(steady[0], steady[1], rtol=0.03)


def test_windings_that_are_read_only_while_their_coil_is_driven_are_enough():
    whole = record()
    seldom = np.where(whole.power > 1.0, whole.winding, np.nan)
    found = network_identification(replace(whole, winding=seldom), NAMES, HEAT)
    assert found.coupling.winding_to_core == pytest.approx(COUPLING.winding_to_core, rel=0.1)


@pytest.mark.parametrize(
    ("wants", "message"),
    [
        ({"always": 1}, "coil 'y' is on in the whole record.*drive each coil alone"),
        ({"driven": (0, 2)}, "coil 'y' was never heated.*drive each coil alone"),
        ({"heated": 8, "cooled": 8}, "coil 'x' was driven alone in only 8 readings"),
        ({"heated": 12, "cooled": 0, "noise": 1.0}, r"\(35 s\) does not determine the .*three minutes"),
        ({"watts": 0.61}, "coil 'x' is on in the whole record"),
        ({"watts": 0.8, "small": 0.0, "noise": 0.01}, "boundary of coil 'x' warmed by only .* heat longer"),
    ],
    ids=["always on", "never on", "too few", "too short", "nothing switched", "lukewarm"],
)
def test_records_that_do_not_tell_are_refused(wants, message):
    with pytest.raises(CalibrationError, match=message):
        network_identification(record(**wants), NAMES, HEAT)


def test_what_is_no_record():
    whole = record(heated=20, cooled=20)
    with pytest.raises(InputError, match="shape"):
        network_identification(replace(whole, power=whole.power[:-1]), NAMES, HEAT)
    with pytest.raises(InputError, match="rising times"):
        network_identification(replace(whole, t=whole.t[::-1].copy()), NAMES, HEAT)
    with pytest.raises(CalibrationError, match="no coil was heated"):
        network_identification(replace(whole, power=0.0 * whole.power), NAMES, HEAT)
    with pytest.raises(CalibrationError, match="winding of coil 'x' was measured fewer"):
        network_identification(replace(whole, winding=np.full_like(whole.winding, np.nan)), NAMES, HEAT)
