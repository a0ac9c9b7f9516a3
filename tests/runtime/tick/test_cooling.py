"""Heat of simulated coils: resettable by a command, never on real ones; a demonstration stays cool."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb.control.linkage import make_linkage
from haptorb.control.registry import make_allocator
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.loader import load
from haptorb.estimation.registry import check_estimator, make_estimator
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.tick import Tick
from haptorb.simulation.hand_motion import guide_hand
from haptorb.worlds import find_world

DT = 1e-3


class Rig:
    """The default world of a device under the hand that nobody holds, from `start` [s] of its guided motion on."""

    def __init__(self, name: str, start: float = 0.0) -> None:
        device = load(name)
        hand = PointerTracker(guide=guide_hand(device))
        self.driver = SimDriver.of(device, DT, lambda now: hand.goal(now + start))
        estimator = make_estimator(device, check_estimator(device, None), None)
        world = find_world(device.kind.world)()
        self.tick = Tick(device, world, self.driver, estimator, make_allocator(device), DT, make_linkage(device, None))
        self.device, self.row, self.n = device, self.tick.layout.empty(), 0

    def go(self, ticks: int) -> Rig:
        for _ in range(ticks):
            self.tick.prepare(self.n * DT)
            self.tick.step(self.row, self.n * DT)
            self.n += 1
        return self

    def __getitem__(self, name: str) -> np.ndarray:
        return self.row[self.tick.layout[name]]

    def heat(self, kelvin: float) -> None:
        """Windings and bodies of the simulated coils, and what the guard takes them for."""
        coils = self.driver.simulation._coils  # type: ignore[attr-defined]
        coils["winding"] = coils["body"] = kelvin
        self.tick.protection.state["heat"]["started"] = False


@pytest.mark.parametrize("name", ["omni", "pmsm"])
def test_hot_simulated_coils_are_cool_at_once_and_can_be_engaged(name: str) -> None:
    rig = Rig(name)
    with rig.driver:
        rig.go(50)
        rig.heat(rig.device.coils.heat.stop + 5.0)
        rig.go(3)
        assert rig["trip"][0] == Trip.OVERHEATED
        assert not rig.tick.engage()
        rig.tick.prepare(rig.n * DT)  # a sample from before is no longer true
        rig.tick.cool()
        rig.go(2)
        assert rig["winding"].max() < rig.device.coils.heat.ambient + 2.0
        assert rig.tick.engage()
        rig.go(2)
        assert rig["guard"][0] == GuardState.RAMPING


def test_real_coils_do_not_cool_at_a_word(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig("omni")
    with rig.driver:
        rig.go(5)
        rig.heat(rig.device.coils.heat.derate - 5.0)
        rig.go(3)
        before = rig["winding"].max()
        monkeypatch.setattr(type(rig.driver), "simulated", False)
        rig.tick.cool()
        rig.go(3)
        assert rig["winding"].max() == pytest.approx(before, abs=0.5)


@pytest.mark.parametrize("name", ["omni", pytest.param("pmsm", marks=pytest.mark.slow)])
def test_a_demonstration_that_nobody_touches_never_derates(name: str) -> None:
    """While it moves, and after it: at the load of the hand's rest no winding ever reaches its derating temperature."""
    moving, resting = Rig(name), Rig(name, start=100.0)
    duration = guide_hand(moving.device).duration
    with moving.driver:
        hottest = max(moving.go(200)["winding"].max() for _ in range(int(5 * duration)))
        assert hottest < moving.device.coils.heat.warn
    with resting.driver:
        resting.go(1500)
        assert resting["guard"][0] == GuardState.RUNNING
        assert resting["remaining"][0] == np.inf
