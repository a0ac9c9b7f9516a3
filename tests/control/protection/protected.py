"""Test tools for protection: one tick through the loop's interface, and a protection without limits."""

import numpy as np

from haptorb.control.protection import Protection
from haptorb.control.trip_reasons import GuardState
from haptorb.devices.base import State, WrenchMap
from haptorb.devices.loader import load
from haptorb.estimation.types import Estimate, Pose, Sample

DT = 1e-3
OMNI = load("omni")
STATE = State.at((0, 0, 0.05))
FRESH = Estimate(STATE, WrenchMap(np.zeros((6, 3)), np.zeros(6)), True, 0.0)
PUSH = np.array([0, 0, 0.5, 0, 0, 0.0])


def sample(currents=(0.0, 0.0, 0.0), temperatures=298.15, age=0.0):
    """A reading of (m,) currents [A], `age` [s] old, and temperatures [K]."""
    currents = np.array(currents, dtype=float)
    pose = Pose(0.0, STATE.R_SR, STATE.p, STATE.w, STATE.v, True)
    return Sample(0.0, currents, np.full(currents.shape, temperatures), np.zeros((0, 3)), pose, age)


class Loop:
    """A protection and the ticks that it gets, on a clock of its own.

    The coils measure what may flow and obey the duties at once, unless a tick says otherwise.
    """

    def __init__(self, device=OMNI, arm=0.0):
        self.protection = Protection(device, DT, arm)
        self.now = 0.0
        self.device = device

    def ask(self, wrench=PUSH, estimate=FRESH):
        """(6,) what may be asked in a tick that begins now; the currents of the tick are not protected yet."""
        asked = self.protection.protect_wrench(np.asarray(wrench, float), estimate, self.now).copy()
        self.now += DT
        return asked

    def drive(self, wanted, reading=None, applied=None, estimate=FRESH):
        """(m,) duties for `wanted` currents, and what may flow of them is in `held`."""
        protection = self.protection
        reading = sample(self.held) if reading is None else reading
        applied = self.consistent(reading) if applied is None else np.asarray(applied, float)
        return protection.protect_currents(np.asarray(wanted, float), estimate, reading, applied).copy()

    def tick(self, wanted, reading=None, wrench=PUSH, estimate=FRESH):
        """(m,) the currents that may flow of `wanted`, after a whole tick."""
        self.ask(wrench, estimate)
        self.drive(wanted, reading, estimate=estimate)
        return self.held

    def consistent(self, reading):
        """(m,) duties under which the model of the current check arrives at the `reading`."""
        c = self.protection.coils
        resistance = c["cold"] * (1 + c["coefficient"] * (c["winding"] - c["reference"])) * c["ratio"]
        left = np.exp(-resistance * DT / c["inductance"])
        end = (reading.currents - c["model"] * left) / (1 - left)
        return (end * resistance + c["model_emf"]) / c["voltage"]

    @property
    def held(self):
        """(m,) the currents that may flow [A]."""
        return self.protection.coils["current_commanded"].copy()

    def run(self, ticks=400):
        """Engage and ramp up."""
        self.ask()
        assert self.protection.engage()
        for _ in range(ticks):
            self.tick(np.eye(self.device.channels)[0])
        assert self.protection.guard_state is GuardState.RUNNING
        return self

    def unlimit(self):
        """Nothing limits any more, as far as a number can say that, and the ramp is over."""
        state, coils = self.protection.state, self.protection.coils
        for name in ("force", "torque", "slew", "expiry"):
            state["guard"][name] = np.inf
        state["clock"]["silence"] = state["guard"]["power"] = np.inf
        coils["limit"] = coils["broken"] = 1e9
        state["heat"]["derate"], state["heat"]["stop"] = 1e9, 2e9
        return self.open()

    def open(self):
        """Whatever tripped is over, and everything is let through."""
        guard = self.protection.state["guard"]
        guard["fresh"] = True
        self.protection.engage()
        guard["state"], guard["gain"] = GuardState.RUNNING, 1.0
        return self


def is_off(loop, wrench=PUSH, estimate=FRESH):
    """Whether a tick that wants 5 A gets none, and no duty."""
    loop.ask(wrench, estimate)
    duties = loop.drive(np.full(3, 5.0), sample(), applied=np.zeros(3), estimate=estimate)
    return not loop.held.any() and not duties.any()
