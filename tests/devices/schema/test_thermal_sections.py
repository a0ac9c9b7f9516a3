"""[thermal] and the supply's power in a device file: meaning, optional keys, rejected values."""

import numpy as np
import pytest

from haptorb.devices.loader import load, parse
from haptorb.errors import DeviceError

BASED = 'based_on = "omni"\nname = "mine"\n'


def test_a_file_without_couplings_is_the_uncoupled_case():
    """Every other kind, and every file that does not say more: no coil warms another, and the supply has no limit."""
    pmsm = load("pmsm")
    assert pmsm.coils.heat.coupling is None
    assert pmsm.supply.power == np.inf
    assert np.count_nonzero(pmsm.coils.heat.network(3).rise_per_watt) == 3


def test_values_and_reasons_are_read():
    mine = parse(f'{BASED}[thermal.coupling]\nwinding_to_core = ["0.1 W/K", "0.2 W/K", "300 mW/K"]\n', "mine")
    assert mine.coils.heat.coupling.winding_to_core == (0.1, 0.2, 0.3)
    assert mine.coils.heat.coupling.core_capacity == load("omni").coils.heat.coupling.core_capacity
    assert {"thermal.tolerance", "thermal.coupling.core_capacity", "supply.power"} <= set(mine.assumed)
    weak = parse(f'{BASED}[supply]\npower = "0.3 kW"\n', "mine")
    assert weak.supply.power == 300.0
    assert weak.digest != load("omni").digest


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[thermal.coupling]\nwinding_to_core = ["0.5 W/K"]\n', "has 1 values for 3 coils"),
        (
            '[thermal.coupling]\nwinding_to_core = ["0.5 W/K", "0.5 W/K", "0 W/K"]\n',
            "winding_to_core",
        ),
        ('[thermal.coupling]\ncore_capacity = "5 mJ/K"\n', "core_capacity gives a time constant of 3.33 ms"),
        ('[thermal.coupling]\ncore_capacity = "50 J"\n', "a heat capacity"),
        ("[thermal]\ntolerance = 0.7\n", "thermal.tolerance must be"),
        ("[thermal]\ncore = 1\n", "thermal.core"),
        ('[supply]\npower = "0 W"\n', "supply.power must be"),
        ('[supply]\npower = "360 V"\n', "supply.power must be a power"),
        ('[supply]\npower = "360 mW"\n', "supply.power is 0.36 W.*240 W.*check its unit"),
    ],
)
def test_what_cannot_be_is_refused_with_its_place(text, message):
    with pytest.raises(DeviceError, match=message):
        parse(BASED + text, "mine")


def test_a_supply_that_never_gives_a_coil_its_limit_is_remarked():
    assert any("supply.power" in line for line in parse(f'{BASED}[supply]\npower = "100 W"\n', "mine").remarks)
    assert not any("supply.power" in line for line in load("omni").remarks)
