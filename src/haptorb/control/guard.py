"""Guard: limits on wrench and current, and the conditions that switch the coils off until the user engages.

Off is the default state and the final state of every path. A trip latches with its reason; only the user can engage
again, and only once the reason is gone. The guard does not rely on any other module, in particular not on the world.

Lines that enforce a rule are marked with `safety:` and its name; `scripts/prove_safety.py` breaks each and checks that
a test fails.
"""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array, Record, Records, fields, state_zeros
from haptorb.compiled import kernel
from haptorb.control.force_transitions import RAMP_UP_S, limit_client_rate, note_uncommanded
from haptorb.control.heat import derating_share
from haptorb.control.missed_deadlines import CLOCK, advance_clock, make_clock
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.base import Device

__all__ = [
    "COIL",
    "ENERGY_CREDIT_J",
    "HISTORY_TICKS",
    "PROTECTION",
    "begin_tick",
    "check_estimate",
    "check_readings",
    "limit_currents",
    "limit_wrench",
    "make_coils",
    "make_state",
    "trip",
]


_RAMP_DOWN_S = 0.05  #: to zero after a pose became stale [s]; the other reasons switch off at once
_MAX_ABSENCE_S = 0.5  #: time without a tick after which only a person can engage again: the process was stopped [s]
_DERATING_HYSTERESIS_K = 1.0  #: hysteresis: below the derating temperature before full current may flow again [K]

_OFF, _RAMPING, _RUNNING = int(GuardState.OFF), int(GuardState.RAMPING), int(GuardState.RUNNING)
_DERATED, _TRIPPED = int(GuardState.DERATED), int(GuardState.TRIPPED)
_EXPIRED, _LOST, _REVERSED = int(Trip.POSE_EXPIRED), int(Trip.POSE_LOST), int(Trip.MAGNET_REVERSED)
_WORLD, _CURRENTS = int(Trip.WORLD_NOT_FINITE), int(Trip.CURRENTS_NOT_FINITE)
_OVERHEATED, _OVERRUN = int(Trip.OVERHEATED), int(Trip.OVERRUN)
_NONE, _SAMPLE, _GUARD_OVERCURRENT = int(Trip.NONE), int(Trip.SAMPLE_NOT_FINITE), int(Trip.OVERCURRENT)


@kernel
def trip(g: Record, reason: int) -> None:
    """Switch the coils off, latched. The first `reason` remains until a person engages; later ones do not replace
    it."""
    if reason != _EXPIRED:  # that reason fades out; any other one meanwhile, such as a Stop, ends the fade at once
        g.gain = 0.0
    if g.state == _TRIPPED:
        return
    g.state = _TRIPPED  # safety: trips-latch
    g.reason = reason
    g.trips += 1


@kernel
def begin_tick(clock: Record, g: Record, now: float) -> None:
    """Start a tick at `now` [s]: ramps, slew limits, heat and expiry advance by the elapsed time.

    After a silence in which the device's watchdog has switched off, the ramp starts again at zero. Too many missed
    deadlines trip, and so does a silence after which the user no longer expects a force. clock is a CLOCK, g a GUARD.
    """
    g.dt = advance_clock(clock, now)
    if clock.restart:
        g.dt = clock.period  # ramps and slew limits do not advance by a silence
    if g.state == _OFF or g.state == _TRIPPED:
        clock.missed[:] = 0.0
        return
    absent = clock.elapsed > _MAX_ABSENCE_S  # safety: absence-trips
    if absent or clock.overrun:  # safety: missed-deadlines-trip
        trip(g, _OVERRUN)
    elif clock.restart:  # safety: ramp-after-silence
        g.state = _RAMPING
        g.gain = 0.0
        g.restarted = True


@kernel
def check_estimate(g: Record, valid: bool, age: float, reversed: bool) -> None:
    """Trip unless the pose is `valid`, its `age` [s] below the expiry, and the magnet not reversed."""
    g.fresh = valid and age <= g.expiry  # safety: stale-poses-trip, lost-poses-trip
    if reversed:  # safety: reversed-magnet-trips
        trip(g, _REVERSED)
    elif not g.fresh and g.state != _OFF and g.state != _TRIPPED:
        trip(g, _EXPIRED if valid else _LOST)


@kernel
def _fade(g: Record) -> None:
    if g.state == _TRIPPED:
        g.gain = max(0.0, g.gain - g.dt / _RAMP_DOWN_S)
    elif g.state == _RAMPING:
        g.gain = min(1.0, g.gain + g.dt / RAMP_UP_S)
        if g.gain == 1.0:
            g.state = _RUNNING


@kernel
def limit_wrench(g: Record) -> None:
    """Clamp and fade g.wrench_commanded (6,) [N, N·m] to the part that may be commanded now; zero when it is off."""
    _fade(g)
    wrench = g.wrench_commanded
    force, torque = 0.0, 0.0
    for i in range(3):
        force += wrench[i] * wrench[i]
        torque += wrench[3 + i] * wrench[3 + i]
    force, torque = np.sqrt(force), np.sqrt(torque)
    if not np.isfinite(force + torque):  # safety: nan-wrench-trips
        if g.state != _OFF:
            trip(g, _WORLD)
        wrench[:] = 0.0
        return
    f = g.gain if force <= g.force else g.gain * g.force / force  # safety: force-is-clamped
    t = g.gain if torque <= g.torque else g.gain * g.torque / torque  # safety: torque-is-clamped
    for i in range(3):
        wrench[i] *= f
        wrench[3 + i] *= t
    note_uncommanded(g)


@kernel
def check_readings(coils: Records) -> int:
    """Trip reason found in the measured currents and temperatures alone, 0 for none."""
    total = 0.0
    beyond = False
    for j in range(coils.size):
        c = coils[j]
        total += c.current + c.boundary
        beyond = beyond or abs(c.current) > c.broken
    if not np.isfinite(total):  # safety: nan-readings-trip
        return _SAMPLE
    return _GUARD_OVERCURRENT if beyond else _NONE  # safety: overcurrent-trips


@kernel
def limit_currents(g: Record, heat: Record, coils: Records, requested: Array, pushes: bool, turns: bool) -> None:
    """Fill `current_commanded` of `coils` (m,) with the part of `requested` (m,) [A] that may flow: clamped,
    slew-limited, derated when warm, limited to the rate of a client's force, zero when off. pushes, turns: whether
    force and torque are rendered."""
    if g.restarted:
        _clear_currents(g, coils)
        g.restarted = False
    if not heat.hottest < heat.stop:  # safety: hot-coils-trip
        trip(g, _OVERHEATED)
    if g.state == _OFF or (g.state == _TRIPPED and g.gain == 0.0):
        _clear_currents(g, coils)
        return
    if heat.hottest > heat.derate and g.state == _RUNNING:
        g.state = _DERATED
    elif g.state == _DERATED and heat.hottest < heat.derate - _DERATING_HYSTERESIS_K:
        g.state = _RUNNING
    for j in range(requested.size):
        if not np.isfinite(requested[j]):  # safety: nan-currents-trip
            trip(g, _CURRENTS)
            _clear_currents(g, coils)
            return
    scale = _hold(g, coils, requested, derating_share(heat))  # safety: warm-coils-are-derated
    if g.client_flows and g.state != _TRIPPED:  # safety: fades-are-free
        limit_client_rate(g, coils, requested, scale, pushes, turns)  # safety: clients-flow-at-their-rate


@kernel
def _clear_currents(g: Record, coils: Records) -> None:
    g.allowance[:] = 0.0
    g.client_flows = False
    for j in range(coils.size):
        coils[j].current_commanded = 0.0


@kernel
def _hold(g: Record, coils: Records, requested: Array, share: float) -> float:
    """Scale `share` of `requested` (m,) [A] into the limits of coils and supply, then apply the slew-rate limit.

    Returns the scale. Directions are preserved. The result is within the supply's power too, because it lies between
    two currents that are.
    """
    scale, step = share, g.slew * g.dt
    for j in range(requested.size):
        if abs(requested[j]) * scale > coils[j].limit:  # safety: current-is-clamped
            scale = coils[j].limit / abs(requested[j])
    power = 0.0
    for j in range(requested.size):
        power += coils[j].hot * (scale * requested[j]) ** 2
    if power > g.power:  # safety: supply-power-is-kept
        scale *= np.sqrt(g.power / power)
    largest = 0.0
    for j in range(requested.size):
        largest = max(largest, abs(scale * requested[j] - coils[j].current_commanded))
    slewed = 1.0 if largest <= step else step / largest  # safety: current-slews
    for j in range(requested.size):
        coils[j].current_commanded += slewed * (scale * requested[j] - coils[j].current_commanded)
    return scale


# --------------------------------------------------------------------------------------------------
# State of protection between two ticks, with its settings: two structured arrays.
#
# `PROTECTION` has the state that exists once, in an array of one record; `COIL` has one record per coil (m).
# Both are created by `make_state` and `make_coils`, changed by the kernels of this package, and readable by all
# modules.


ENERGY_CREDIT_J = 2e-4  #: energy that may be generated before passivity control acts [J]: 0.1 kg at 6 cm/s
HISTORY_TICKS = 128  #: length of the wrench history of passivity control, from the last pose but one on
_OVERCURRENT_RATIO = 1.25  #: ratio of measured to allowed current that indicates a fault of wiring or driver
_MIN_WINDING_K, _MAX_WINDING_K = 233.15, 453.15  #: a winding temperature outside this range indicates a fault [K]
_MIN_LEARNING_CURRENT = 0.025  #: current, relative to the limit, above which its resistance is estimated


#: The estimator's output in this tick: age of the pose and whether it is valid, pose and motion of the mover.
ESTIMATE = fields(
    ("age", "f8"),  # [s]
    ("position", "f8", (3,)),  # [m]
    ("rotation", "f8", (3, 3)),  # R_SR
    ("velocity", "f8", (3,)),  # [m/s]
    ("angular_velocity", "f8", (3,)),  # [rad/s]
    ("valid", "?"),
)

GUARD = fields(
    ("state", "i8"),  # GuardState
    ("reason", "i8"),  # Trip: why the coils are off
    ("trips", "i8"),  # number of trips so far
    ("gain", "f8"),  # factor on the wrench now, 0 to 1
    ("wrench_commanded", "f8", (6,)),  # wrench that may be commanded now [N, N·m]
    ("dt", "f8"),  # time by which ramps and slew advance in this tick [s]
    ("fresh", "?"),  # whether the last estimate was valid
    ("restarted", "?"),  # the device's watchdog has switched off: currents start at zero
    ("expiry", "f8"),  # maximum age of a pose [s]
    ("force", "f8"),  # limit [N]
    ("torque", "f8"),  # limit [N·m]
    ("slew", "f8"),  # limit [A/s]
    ("power", "f8"),  # of the supply for all coils [W]
    ("force_rate", "f8"),  # limit at a change of client or world, and of a client's force [N/s]
    ("torque_rate", "f8"),  # the same [N·m/s]
    ("commanded", "f8", (6,)),  # part of the world's wrench that a client commands in this tick [N, N·m]
    ("session", "f8"),  # of the client whose force is rendered
    ("mapping", "f8"),  # number of that client's mapping
    ("client", "f8", (6,)),  # a client's wrench as rendered [N, N·m]
    ("world", "f8", (6,)),  # the wrench of the world without it, as rendered [N, N·m]
    ("leaving", "?"),  # a change of world: the wrench goes to zero
    ("arriving", "?"),  # and then to the wrench of the new world
    ("wrench_rendered", "f8", (6,)),  # both together [N, N·m]
    ("uncommanded", "f8", (6,)),  # part of `wrench_commanded` that no client commands [N, N·m]
    ("allowance", "f8", (2,)),  # step of force [N] and torque [N·m] still allowed for this part
    ("client_flows", "?"),  # the currents contain a client's wrench: their change is limited to its rates
)

HEAT = fields(
    ("hottest", "f8"),  # winding [K]; NaN if any is
    ("remaining", "f8"),  # time until a winding reaches `derate` under the present load [s]; inf if never
    ("remaining_age", "f8"),  # time since `remaining` was computed [s]
    ("pending", "f8"),  # time of ticks without readings [s]
    ("started", "?"),  # whether there was a first reading
    ("derate", "f8"),  # winding temperature above which the current is derated [K]
    ("stop", "f8"),  # winding temperature at which the coils are switched off [K]
    ("coefficient", "f8"),  # of the resistance [1/K]
    ("reference", "f8"),  # temperature of the resistances [K]
    ("ambient", "f8"),  # [K]
    ("winding_capacity", "f8"),  # [J/K]
    ("body_capacity", "f8"),  # [J/K]
    ("winding_to_body", "f8"),  # [W/K]
    ("body_to_air", "f8"),  # [W/K]
    ("tolerance", "f8"),  # relative, of capacities and conductances
    ("core", "f8"),  # temperature of the core between coupled coils [K]
    ("core_capacity", "f8"),  # [J/K]; 0 where coils are not coupled
)

DRIVE = fields(
    ("supply", "f8"),  # voltage [V]
    ("dt", "f8"),  # length of the last tick and of the next one at most [s]
)

PASSIVITY = fields(
    ("energy", "f8"),  # delivered to the hand since the world began [J]
    ("balance", "f8"),  # energy dissipated by the minimum hand damping minus energy generated by sampling and delay [J]
    ("damping", "f8"),  # injected now [N·s/m]
    ("softened", "f8"),  # present reduction of the world's wrench, 0 to 1
    ("softer", "f8"),  # setpoint of the same
    ("since", "f8"),  # beginning of the present summation interval [s]
    ("moved", "f8", (3,)),  # |v|² over this interval and the two before [m²/s]
    ("made", "f8"),  # energy generated by sampling and delay in this interval [J]
    ("spread", "f8"),  # sum of the squares of that energy from pose to pose [J²]
    ("poses", "f8"),  # number of poses in this interval at which the world acted
    ("taken", "f8"),  # energy dissipated by the minimum damping in this interval, where the world acted [J]
    ("touched", "f8"),  # time at which the world last acted on the hand [s]
    ("smooth", "f8", (6,)),  # velocity, low-pass filtered [m/s, rad/s]
    ("stamp", "f8"),  # measurement time of the last counted pose [s]; -inf before the first
    ("newest", "f8"),  # latest stamp so far [s]
    ("predicted", "i8"),  # ticks for which poses still count as predictions of the present
    ("count", "i8"),  # wrenches stored since the start
    ("spacing", "f8"),  # between them, with poses so late that the buffer cannot store every tick [s]
    ("passive", "?"),  # whether the world is passive; an active one is observed only
    ("arm", "f8"),  # lever arm of the hand on a mover that turns [m]; 0 where no torque is rendered
    ("pushes", "?"),  # whether force is rendered, not torque alone
    ("dt", "f8"),  # nominal tick [s]
    ("lag", "f8"),  # delay of the wrench through the coils [s]
    ("position", "f8", (3,)),  # of the last counted pose [m]
    ("rotation", "f8", (3, 3)),  # of the last counted pose
    ("wrench", "f8", (6,)),  # of the world at the last counted pose [N, N·m]
    ("stored", "f8"),  # energy stored in the world's state now [J]; NaN if not defined
    ("counted", "f8"),  # the same at the last counted pose [J]
    ("world_wrench", "f8", (6,)),  # wrench of the world at the last counted pose, before the guard [N, N·m]
    # energy generated by the world's time step: delivered plus stored now, minus stored before plus absorbed [J]
    ("surplus", "f8"),
    ("motion", "f8", (6,)),  # velocity [m/s] and angular velocity [rad/s] since the pose before
    ("mean", "f8", (6,)),  # mean commanded wrench between the last two poses [N, N·m]
    ("times", "f8", (HISTORY_TICKS,)),  # ring buffer: time from which each wrench was commanded [s]
    ("wrenches", "f8", (HISTORY_TICKS, 6)),  # ring buffer: wrenches [N, N·m]
)

#: One record.
PROTECTION = fields(
    ("clock", CLOCK),
    ("estimate", ESTIMATE),
    ("guard", GUARD),
    ("heat", HEAT),
    ("drive", DRIVE),
    ("passivity", PASSIVITY),
)

#: One record per coil.
COIL = fields(
    # settings from the device file
    ("limit", "f8"),  # current [A]
    ("broken", "f8"),  # current that indicates a fault of wiring or driver [A]
    ("voltage", "f8"),  # of the supply [V]
    ("cold", "f8"),  # resistance at the reference temperature [Ω]
    ("reference", "f8"),  # temperature [K]
    ("coefficient", "f8"),  # [1/K]
    ("inductance", "f8"),  # [H]
    ("least", "f8"),  # minimum resistance of the winding [Ω]
    ("greatest", "f8"),  # maximum resistance of the winding [Ω]
    ("to_core", "f8"),  # heat conductance from winding to core [W/K]; 0 where coils are not coupled
    ("hot", "f8"),  # resistance at the stop temperature [Ω]
    ("learnable", "f8"),  # current above which the resistance is estimated [A]
    # this tick
    ("current", "f8"),  # measured [A]
    ("boundary", "f8"),  # temperature measured [K]
    ("applied", "f8"),  # duty since the last tick
    ("wrench", "f8", (6,)),  # on the mover per ampere [N/A, N·m/A]
    ("emf", "f8"),  # voltage that the moving mover induces [V]
    # guard
    ("current_commanded", "f8"),  # allocated current after the limits [A]
    # heat
    ("winding", "f8"),  # temperature [K]
    ("body", "f8"),  # temperature [K]
    ("heating", "f8"),  # i²R at the reference temperature, mean of this tick [W]
    ("load", "f8"),  # i²R at the reference temperature, averaged [W]
    ("heat_current", "f8"),  # measured at the last heat update [A]
    ("ahead_winding", "f8"),  # predicted temperature, for the remaining time [K]
    ("ahead_body", "f8"),  # [K]
    ("free", "f8"),  # of that winding for a core at zero [K]
    ("share", "f8"),  # of the core's temperature in that winding's
    ("body_free", "f8"),  # of that body for a winding at zero [K]
    ("body_share", "f8"),  # of the winding's temperature in that body's
    # drive
    ("resistance", "f8"),  # estimated [Ω]
    ("duty", "f8"),  # chosen in this tick, −1 to 1
    ("current_expected", "f8"),  # expected current at the end of the tick [A]
    ("drive_current", "f8"),  # measured at the last resistance update [A]
    ("drive_emf", "f8"),  # emf at the last choice of duties [V]
    ("volts", "f8"),  # sliding mean of voltage times current [V·A]
    ("squares", "f8"),  # sliding mean of current squared [A²]
    # check of the measured currents
    ("ratio", "f8"),  # estimated over expected resistance
    ("model", "f8"),  # current at the last tick [A]
    ("model_before", "f8"),  # at the beginning of the interval before the last tick [A]
    ("model_end", "f8"),  # steady-state value of the interval before the last tick [A]
    ("model_time", "f8"),  # length of that interval [s]
    ("model_emf", "f8"),  # emf at the last tick [V]
    ("residual", "f8"),  # smoothed difference of measured and model [A]
    ("level", "f8"),  # smoothed magnitude of the current [A]
    ("change", "f8"),  # smoothed change of the current per tick [A]
    ("square", "f8"),  # smoothed square of the model's current at the time of measurement [A²]
    ("product", "f8"),  # smoothed product of that current and the measured one [A²]
)


def make_state(device: Device, dt: float, arm: float = 0.0, lag: float = 0.0) -> Records:
    """(1,) PROTECTION for `device` and ticks `dt` [s] apart: off, before the first tick.

    arm: lever arm of the hand on a rotating mover [m]; lag: delay of the wrench through the coils [s].
    """
    limits, coils = device.limits, device.coils
    thermal = coils.heat
    state = state_zeros(1, PROTECTION)
    state["clock"] = make_clock(dt)
    guard, heat, passivity = state["guard"], state["heat"], state["passivity"]
    guard["state"] = GuardState.OFF  # safety: off-by-default
    guard["dt"] = dt
    for name in ("expiry", "force", "torque", "slew", "force_rate", "torque_rate"):
        guard[name] = getattr(limits, name)
    guard["power"] = device.supply.power
    heat["hottest"] = heat["core"] = heat["ambient"] = thermal.ambient
    heat["remaining"] = np.inf
    heat["derate"], heat["stop"] = thermal.derate, thermal.stop
    heat["coefficient"], heat["reference"] = coils.temperature_coefficient, coils.reference_temperature
    for name in ("winding_capacity", "body_capacity", "winding_to_body", "body_to_air"):
        heat[name] = getattr(thermal, name)
    heat["tolerance"] = thermal.tolerance
    heat["core_capacity"] = 0.0 if thermal.coupling is None else thermal.coupling.core_capacity
    state["drive"]["supply"], state["drive"]["dt"] = device.supply.voltage, dt
    passivity["arm"], passivity["dt"], passivity["lag"] = arm, dt, lag
    passivity["balance"], passivity["passive"], passivity["pushes"] = ENERGY_CREDIT_J, True, True
    passivity["stamp"] = passivity["newest"] = -np.inf
    return state


def make_coils(device: Device) -> Records:
    """(m,) COIL for `device`: at ambient temperature and without current."""
    coils = device.coils
    ambient = np.full(device.channels, coils.heat.ambient)
    made = state_zeros(device.channels, COIL)
    made["limit"], made["broken"] = coils.current_limit, _OVERCURRENT_RATIO * coils.current_limit
    made["learnable"] = _MIN_LEARNING_CURRENT * coils.current_limit
    made["voltage"] = device.supply.voltage
    made["cold"], made["inductance"] = coils.resistance, coils.inductance
    made["reference"], made["coefficient"] = coils.reference_temperature, coils.temperature_coefficient
    made["hot"] = device.greatest_resistance
    made["least"] = coils.resistance_at(np.full(device.channels, _MIN_WINDING_K))
    made["greatest"] = coils.resistance_at(np.full(device.channels, _MAX_WINDING_K))
    made["to_core"] = 0.0 if coils.heat.coupling is None else coils.heat.coupling.winding_to_core
    made["resistance"] = coils.resistance_at(ambient)
    made["winding"] = made["body"] = ambient
    made["ratio"] = 1.0
    return made
