"""Heat step on a computer with interruptions: lost time is recorded, other errors are not tolerated."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from haptorb.cli.calibration_measurement import DriverSession, make_driver
from haptorb.cli.heat_measurement import HeatingSchedule, identify_heat
from haptorb.devices.loader import load
from haptorb.errors import CalibrationError, DriverError, HostSilent
from haptorb.runtime.drivers.base import Driver
from haptorb.simulation.electromagnet import draw_network

_FILE: Any = load("omni")
#: of which the simulated device is no other specimen: the record is short
OMNI: Any = replace(_FILE, coils=replace(_FILE.coils, heat=replace(_FILE.coils.heat, tolerance=0.0)))
COURSE = HeatingSchedule(heating=45.0, cooling=30.0)
COLD = OMNI.coils.resistance_at(np.full(3, OMNI.coils.heat.ambient))
TRIPPED = "the firmware switched the coils off: a test wanted it"


class Hesitant(Driver):
    """The simulated device, which switches off at `trips` [s], with current only, and stays off until engaged again."""

    name, simulated = "hesitant", True

    def __init__(self, trips: Iterable[float], kind: type[DriverError] = HostSilent) -> None:
        self.inner, self.pace = make_driver("sim", OMNI, 5)
        self.trips, self.kind, self.off, self.live, self.engaged = sorted(trips), kind, False, False, 0

    def open(self) -> None:
        self.inner.open()

    def close(self) -> None:
        self.inner.close()

    def read(self, now: float) -> Any:
        sample = self.inner.read(now)
        if self.live and self.trips and now >= self.trips[0]:
            self.trips.pop(0)
            self.off, self.live = True, False
            self.inner.write(np.zeros(3))
            raise self.kind(TRIPPED)
        return sample

    def write(self, duties: Any) -> Any:
        self.live = not self.off and bool(np.any(duties))
        return self.inner.write(duties if self.live else 0.0 * duties)

    def engage(self) -> None:
        self.off = False
        self.engaged += 1

    def wrench_actual(self) -> Any:
        return self.inner.wrench_actual()


def identify_with(driver: Hesitant) -> Any:
    with driver:
        return identify_heat(DriverSession(OMNI, driver, driver.pace), OMNI, COLD, COURSE)


def test_seconds_that_were_lost_do_not_spoil_the_record() -> None:
    """Within the time of the record the values predict what the simulated coils do: one coil at 20 W, all windings."""
    trips = (0.55, 7.3, 8.9, 21.35, 40.0, 89.95, 101.5, 130.2, 150.2)
    seconds, power = COURSE.seconds(OMNI), (20.0, 0.0, 0.0)
    true = draw_network(OMNI).rise(seconds, power)[:3]
    whole, torn = identify_with(Hesitant(())), identify_with(driver := Hesitant(trips))
    assert (whole.lost, torn.lost, driver.engaged) == (0, len(trips), len(trips))
    assert whole.found.network.rise(seconds, power)[:3] == pytest.approx(true, rel=0.08)
    assert torn.found.network.rise(seconds, power)[:3] == pytest.approx(true, rel=0.12)
    for name in ("winding_capacity", "winding_to_body"):
        assert getattr(torn.found.model, name) == pytest.approx(getattr(OMNI.coils.heat, name), rel=0.25)
    assert torn.found.residual < 2 * whole.found.residual + 0.1


@pytest.mark.parametrize("ambient", [pytest.param(288.15, marks=pytest.mark.slow), 308.15])
def test_a_room_that_is_warmer_or_colder_than_the_reference(ambient: float) -> None:
    """A winding's temperature is that at which its resistance, stated at 20 °C, is the measured one.

    Of a record without a cold start of the wire's coefficient: R(T) = R20 (1 + α (T − 20 °C)).
    """
    heat = replace(OMNI.coils.heat, ambient=ambient)
    device = replace(OMNI, coils=replace(OMNI.coils, heat=heat))
    found, rises = [], []
    for one in (OMNI, device):
        driver = Hesitant(())
        driver.inner, driver.pace = make_driver("sim", one, 5)
        with driver:
            resistance = one.coils.resistance_at(np.full(3, one.coils.heat.ambient))
            result = identify_heat(DriverSession(one, driver, driver.pace), one, resistance, COURSE)
        seconds, power = COURSE.seconds(one), (20.0, 0.0, 0.0)
        found.append(result.found.network.rise(seconds, power)[:3])
        rises.append(draw_network(one).rise(seconds, power)[:3])
    errors = [known / true - 1 for known, true in zip(found, rises, strict=True)]
    assert errors[1] == pytest.approx(errors[0], abs=0.02)


def test_any_other_trip_ends_the_step() -> None:
    driver = Hesitant((7.3,), DriverError)
    with pytest.raises(DriverError, match="a test wanted it"):
        identify_with(driver)
    assert driver.engaged == 0


def test_a_record_that_is_mostly_pauses_is_refused() -> None:
    with pytest.raises(CalibrationError, match=r"too busy: 34 of .* s of readings are lost"):
        identify_with(Hesitant(np.arange(1.0, 160.0, 2.5)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda amperes: amperes * (0, 1, 1), "coil 'x' carries no current during heating"),
        (
            lambda amperes: amperes + np.array([0, 3.5, 0]),
            "coil 'y' carries 4.5 A where 1.0 A should flow: it does not switch",
        ),
    ],
    ids=["dead", "always on"],
)
def test_a_coil_that_does_not_switch_ends_the_step(change: Any, message: str) -> None:
    class StuckDriver(Hesitant):
        def read(self, now: float) -> Any:
            sample = super().read(now)
            return replace(sample, currents=change(sample.currents)) if self.live else sample

    with pytest.raises(CalibrationError, match=message):
        identify_with(StuckDriver(()))


def test_coils_that_do_not_warm_each_other_need_one_record_only() -> None:
    """As before there were couplings: the first coil alone, and two nodes."""
    heat = replace(OMNI.coils.heat, coupling=None)
    device = replace(OMNI, coils=replace(OMNI.coils, heat=heat))
    assert COURSE.seconds(device) == 75.0 < COURSE.seconds(OMNI) == 165.0
    driver = Hesitant(())
    driver.inner, driver.pace = make_driver("sim", device, 5)
    with driver:
        session = DriverSession(device, driver, driver.pace)
        found: Any = identify_heat(session, device, COLD, replace(COURSE, heating=90.0)).found
    assert found.model.body_to_air == pytest.approx(heat.body_to_air, rel=0.3)
    assert not hasattr(found, "coupling")
