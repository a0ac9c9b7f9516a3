"""A device determined by its windings: moments, resistance, inductance, heat capacity."""

import numpy as np
import pytest

from haptorb.devices.loader import load, parse
from haptorb.errors import DeviceError
from haptorb.magnetics.dipole import MU0

OMNI = load("omni")


HEAD = 'based_on = "omni"\nname = "wound"\ndrop = ["coils.current_limit"]\n[windings]\n'


def wind(*lines, fill=0.6, override=False):
    return parse(f"{HEAD}fill = {fill}\n" + "\n".join(lines), "wound", override=override)


def test_the_windings_decide_where_their_fill_is_given():
    device = wind()
    assert device.moments_from == "windings"
    assert device.moment_per_current == pytest.approx(OMNI.predict_moments())
    expected = [coil.resistance(0.6) for coil in OMNI.windings.coils]
    assert device.coils.resistance == pytest.approx(expected, rel=1e-3)  # 20 °C is 293.15 K
    mass = sum(coil.heat_capacity(0.6) for coil in OMNI.windings.coils) / 3
    assert device.coils.heat.winding_capacity == pytest.approx(mass)
    assert OMNI.coils.resistance == pytest.approx(0.6)  # the paper's own values stay where no fill is given


def test_more_turns_more_moment_resistance_and_inductance_for_the_same_heat():
    single, double = wind(), wind("turns = [184, 182, 168]", override=True)
    assert double.moment_per_current == pytest.approx(2 * single.moment_per_current)
    assert double.coils.resistance == pytest.approx(4 * single.coils.resistance)
    assert double.coils.inductance == pytest.approx(4 * single.coils.inductance)


def test_a_smaller_core_gives_less_moment_and_less_inductance():
    small = wind("[electromagnet]", 'core_radius = "12 mm"')
    assert (np.diag(small.moment_per_current) < 0.9 * np.diag(wind().moment_per_current)).all()
    assert (small.coils.inductance < wind().coils.inductance).all()


def test_the_core_adds_the_inductance_that_its_flux_through_the_turns_is():
    """A sphere of moment m at the centre of a thin loop links µ0 m/2R with it."""
    core = OMNI.core
    for coil, whole, parts in zip(
        OMNI.windings.coils, OMNI.windings.inductance(core), OMNI.windings.parts(core), strict=True
    ):
        radii, heights, turns = coil.filaments(8, 8)
        linked = float(np.sum(turns * MU0 * parts[1] * radii**2 / (2 * np.hypot(radii, heights) ** 3)))
        assert whole == pytest.approx(coil.inductance + linked, rel=1e-6)


@pytest.mark.parametrize("fill", [0, 0.95, -1])
def test_a_fill_that_no_wire_has_is_named(fill):
    with pytest.raises(DeviceError, match=r"windings\.fill"):
        wind(fill=fill)
