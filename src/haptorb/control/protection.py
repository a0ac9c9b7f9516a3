"""Protection of device and user: limits on wrench and current before the coils.

Commands pass only if they are finite, within limits and slew rates, based on a fresh pose, and the coils are cool
enough. The loop calls `protect_wrench` before the allocator and `protect_currents` after it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from haptorb.arrays import Array, Record, Records, StateArray, Stateful, state_zeros
from haptorb.compiled import kernel, tick_kernel
from haptorb.control import guard
from haptorb.control.drive import check_currents, choose_duties, lag_of, rest_coils
from haptorb.control.force_transitions import pass_over
from haptorb.control.guard import (
    begin_tick,
    check_estimate,
    check_readings,
    limit_currents,
    limit_wrench,
    make_coils,
    make_state,
    trip,
)
from haptorb.control.heat import observe_heat
from haptorb.control.passivity import damp_wrench, restart_passivity
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.base import Device

if TYPE_CHECKING:
    from haptorb.estimation.types import Estimate, Sample

__all__ = ["Protection", "protect_currents", "protect_wrench", "skip_tick"]


# --------------------------------------------------------------------------------------------------
# Protection of one tick in two compiled passes, before and after the allocator: of the wrench, then of the currents.
#
# Order of the rules: passivity control and guard; then current check, heat, guard and drive.


_SAMPLE, _MISMATCH = int(Trip.SAMPLE_NOT_FINITE), int(Trip.CURRENT_MISMATCH)


@tick_kernel
def protect_wrench(
    state: Records, wrench: Array, p: Array, R: Array, v: Array, w: Array, now: float, age: float, valid: bool,
    reversed: bool, session: float, mapping: float,
) -> None:  # fmt: skip
    """Start a tick at `now` [s]: the part of the world's `wrench` (6,) [N, N·m] that may be commanded, after rate
    limits, damping and clamping, is in guard.wrench_commanded of `state`, (1,) PROTECTION. The part of it that the
    client `session` commands through its `mapping` is in guard.commanded. `estimate` gives pose and motion."""
    s = state[0]
    g, e = s.guard, s.estimate
    _keep_estimate(e, p, R, v, w)
    e.age, e.valid = age, valid
    begin_tick(s.clock, g, now)
    pass_over(g, wrench, session, mapping)
    damp_wrench(s.passivity, e, g.wrench_rendered, now, g.gain, g.wrench_commanded)
    check_estimate(g, valid, age, reversed)
    limit_wrench(g)


@tick_kernel
def protect_currents(
    state: Records, coils: Records, requested: Array, matrix: Array, currents: Array, age: float, temperatures: Array,
    duty_applied: Array, duty_commanded: Array,
) -> None:  # fmt: skip
    """Fill duty_commanded (m,) for the `requested` currents (m,) [A]: limited, then driven; zero if the guard is off.

    state (1,) PROTECTION and coils (m,) COIL; matrix (6, m) wrench per ampere; currents (m,) [A], `age` [s] old, and
    temperatures (m,) [K] are readings; duty_applied (m,) of the driver since the last tick.
    """
    s = state[0]
    clock, g, heat = s.clock, s.guard, s.heat
    _keep_readings(coils, matrix, currents, temperatures, duty_applied)
    _induce(s.estimate, coils)
    plausible = check_currents(clock, coils, age)
    reason = check_readings(coils)
    if reason == _SAMPLE:
        trip(g, _SAMPLE)  # and the sample is not used for estimation
    else:
        observe_heat(heat, coils, clock.elapsed)  # safety: windings-heat-by-the-clock
        if reason != 0:
            trip(g, reason)
        elif not plausible:  # safety: current-mismatch-trips
            trip(g, _MISMATCH)
    limit_currents(g, heat, coils, requested, s.passivity.pushes, s.passivity.arm > 0.0)
    s.drive.dt = max(clock.elapsed, clock.period)
    if g.gain > 0.0:  # safety: off-means-zero-duties
        choose_duties(s.drive, coils)
    else:
        rest_coils(coils)
    for j in range(coils.size):
        duty_commanded[j] = coils[j].duty


@kernel
def skip_tick(state: Records, now: float) -> None:
    """Advance by a tick at `now` [s] without readings: time passes, and the heat is updated later."""
    s = state[0]
    begin_tick(s.clock, s.guard, now)
    s.heat.pending += s.clock.elapsed


@kernel
def _keep_estimate(e: Record, p: Array, R: Array, v: Array, w: Array) -> None:
    for i in range(3):
        e.position[i], e.velocity[i], e.angular_velocity[i] = p[i], v[i], w[i]
        for j in range(3):
            e.rotation[i, j] = R[i, j]


@kernel
def _keep_readings(coils: Records, matrix: Array, currents: Array, temperatures: Array, duty_applied: Array) -> None:
    for j in range(coils.size):
        c = coils[j]
        c.current, c.boundary, c.applied = currents[j], temperatures[j], duty_applied[j]
        for i in range(6):
            c.wrench[i] = matrix[i, j]


@kernel
def _induce(e: Record, coils: Records) -> None:
    """Back-EMF of the coils: the mechanical power delivered to the mover, per ampere."""
    for j in range(coils.size):
        c = coils[j]
        c.emf = 0.0
        for i in range(3):
            c.emf += e.velocity[i] * c.wrench[i] + e.angular_velocity[i] * c.wrench[3 + i]


_OFF, _TRIPPED = int(GuardState.OFF), int(GuardState.TRIPPED)


class Protection(Stateful):
    """Guard, heat, current check, passivity control and drive of `device`, for a loop of ticks `dt` [s] apart.

    Each tick: `protect_wrench`, allocation, `protect_currents`; or `skip_tick` if nothing could be read.

    arm     lever arm of the hand on a rotating mover [m]; 0 for a tool on which only force is rendered
    state   (1,) PROTECTION and coils (m,) COIL: its whole state
    wrench_commanded  (6,) wrench that may be commanded now [N, N·m]
    commanded  (6,) part of the world's wrench that a client commands in this tick [N, N·m]; the tick fills it
    duty_commanded  (m,) of this tick, −1 to 1
    """

    def __init__(self, device: Device, dt: float, arm: float = 0.0) -> None:
        self.coils: Records = make_coils(device)
        lag = lag_of(self.coils["resistance"], self.coils["inductance"], dt)
        self.state: Records = make_state(device, dt, arm, lag)
        self.duty_commanded: Array = state_zeros(device.channels)
        self._guard: Records = self.state["guard"]
        # Read and written in every tick: access to scalars through a memoryview is twice as fast.
        self._state: Any = self._guard["state"].data
        self._stored: Any = self.state["passivity"]["stored"].data
        self.wrench_commanded: Array = self._guard["wrench_commanded"][0]
        self.commanded: Array = self._guard["commanded"][0]
        spare = self.state.copy()  # compiled at construction, not in the loop
        skip_tick(spare, 0.0)
        guard.trip(spare["guard"][0], int(Trip.NONE))

    def state_arrays(self) -> Mapping[str, StateArray]:
        """Guard, heat, current check, passivity control and drive."""
        return {"state": self.state, "coils": self.coils, "duties": self.duty_commanded}

    def apply_state(self) -> None:
        """Check the restored state. Raises ValueError for an unknown state or reason."""
        GuardState(int(self._guard["state"][0]))
        Trip(int(self._guard["reason"][0]))

    @property
    def guard_state(self) -> GuardState:
        """State of the guard."""
        return GuardState(int(self._state[0]))

    @property
    def reason(self) -> Trip:
        """Reason why the coils are off."""
        return Trip(int(self._guard["reason"][0]))

    @property
    def gain(self) -> float:
        """Factor on the wrench now, 0 to 1."""
        return float(self._guard["gain"][0])

    @property
    def tripped(self) -> bool:
        """Whether the coils are off, latched, until the user engages."""
        return bool(self._state[0] == _TRIPPED)

    @property
    def engaged(self) -> bool:
        """Whether current may flow: neither off nor tripped."""
        return self.guard_state not in (GuardState.OFF, GuardState.TRIPPED)

    def trip(self, reason: Trip) -> None:
        """Switch the coils off, latched. The first reason remains until `engage`; later ones do not replace it."""
        guard.trip(self._guard[0], int(reason))

    def engage(self) -> bool:
        """Leave OFF or TRIPPED and ramp up from zero; False if the reason is still present."""
        if self.engaged:
            return True
        coils, g = self.coils, self._guard
        cool = coils["winding"].max() < self.state["heat"]["derate"][0]
        if not g["fresh"][0] or not cool:  # safety: engaging-blind-is-refused
            return False
        g["state"], g["reason"] = GuardState.RAMPING, Trip.NONE
        g["gain"] = 0.0  # safety: engaging-ramps-from-zero
        # Estimates of the current check may come from a sensor that was repaired meanwhile.
        coils["ratio"] = 1.0
        for name in ("residual", "level", "change", "square", "product"):
            coils[name] = 0.0
        return True

    def start(self, estimate: Estimate) -> None:
        """Engage at the first valid `estimate`. A latched trip remains."""
        if self._state[0] == _OFF:  # safety: a-stop-before-the-first-pose-stands
            self._guard["fresh"] = estimate.valid and estimate.age <= self._guard["expiry"][0]
            self.engage()

    def change_world(self, *, passive: bool, other: bool = False) -> None:
        """Restart the energy balance for a new world, `passive` or not, and change its wrench over at the
        device's rate limits; through zero if it is an `other` world, not the same with other values."""
        restart_passivity(self.state["passivity"], passive)
        leaving = other or bool(self._guard["leaving"][0])  # safety: worlds-pass-zero
        rendered = self.engaged or self.gain > 0.0  # no change-over is needed where nothing is rendered
        self._guard["leaving"], self._guard["arriving"] = rendered and leaving, rendered and not leaving

    def change_part(self, *, pushes: bool, arm: float) -> None:
        """Change the rendered part of the wrench: force or not, and torque with the hand's lever arm `arm` [m], 0 for
        none.

        The balance of energy restarts.
        """
        passivity = self.state["passivity"]
        passivity["pushes"], passivity["arm"] = pushes, arm
        restart_passivity(passivity, bool(passivity["passive"][0]))

    def restart_heat(self) -> None:
        """Initialise the windings at the temperature of the next thermometer reading; for coils that are simulated."""
        self.state["heat"]["started"] = False
        self.coils["load"] = 0.0

    def exclude_next_lateness(self) -> None:
        """Exclude the lateness of the next tick from the overrun count; for a device that is simulated."""
        self.state["clock"]["excused"] = True

    def skip_tick(self, now: float) -> None:
        """Advance by a tick at `now` [s] without readings: time passes, and the heat is updated later."""
        skip_tick(self.state, now)

    def protect_wrench(
        self, wrench: Array, estimate: Estimate, now: float, stored: float = np.nan, session: float = 0.0,
        mapping: float = 0.0,
    ) -> Array:  # fmt: skip
        """Return (6,) the part of the world's `wrench` (6,) that may be commanded in the tick that begins at `now` [s].

        Damped, clamped, faded; zero in any fault. In [N, N·m]. stored: energy in the world's memory [J]; NaN if the
        world does not define it. session and mapping: numbers of the client that commands `commanded`; 0: none.
        """
        mover = estimate.state
        self._stored[0] = stored
        protect_wrench(
            self.state, wrench, mover.p, mover.R_SR, mover.v, mover.w, now, estimate.age, estimate.valid,
            estimate.reversed, session, mapping,
        )  # fmt: skip
        return self.wrench_commanded

    def protect_currents(
        self, current_requested: Array, estimate: Estimate, sample: Sample, duty_applied: Array
    ) -> Array:
        """`duty_commanded` (m,) for the part of `current_requested` (m,) [A] that may flow, after `duty_applied` (m,).

        Currents within limits and slew, derated when warm, zero when off or tripped. Duties in −1 to 1.
        """
        protect_currents(
            self.state, self.coils, current_requested, estimate.wrench_map.matrix, sample.currents, sample.currents_age,
            sample.temperatures, duty_applied, self.duty_commanded,
        )  # fmt: skip
        return self.duty_commanded
