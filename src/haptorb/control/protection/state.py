"""What protection remembers between two ticks, and the settings that it goes by: two structured arrays.

`PROTECTION` holds what is there once, in an array of one record; `COIL` what every coil has, in an array of m records.
Both are made by `make_state` and `make_coils`, changed by the kernels of this package, and read by everybody.
"""

from __future__ import annotations

import numpy as np

from haptorb.control.protection.tick_time import CLOCK, make_clock
from haptorb.control.protection.trip import GuardState
from haptorb.devices.device import Device
from haptorb.numerics.arrays import Records, fields

__all__ = ["COIL", "CREDIT", "PROTECTION", "TICKS", "make_coils", "make_state"]

CREDIT = 2e-4  #: energy that may be made before passivity control acts [J]: 0.1 kg at 6 cm/s
TICKS = 512  #: wrenches that passivity control remembers: more than the expiry of a pose at the fastest rate
_OVERCURRENT = 1.25  #: measured over allowed current at which wiring or driver must be broken
_COLDEST, _HOTTEST = 233.15, 453.15  #: windings outside this are not resistances but faults [K]
_LEARN = 0.025  #: current, as a share of the greatest that may flow, above which its resistance is learned


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
    ("trips", "i8"),  # how often it has tripped
    ("gain", "f8"),  # share of the wrench that is let through now, 0 to 1
    ("asked", "f8", (6,)),  # wrench that may be asked of the coils now [N, N·m]
    ("dt", "f8"),  # time by which ramps and slew advance in this tick [s]
    ("fresh", "?"),  # whether the last estimate was valid
    ("restarted", "?"),  # the device has switched off by itself: currents begin at zero
    ("expiry", "f8"),  # greatest age of a pose [s]
    ("force", "f8"),  # limit [N]
    ("torque", "f8"),  # limit [N·m]
    ("slew", "f8"),  # limit [A/s]
    ("power", "f8"),  # that the supply gives to all coils [W]
    ("force_rate", "f8"),  # limit of what passes over, and of a client's force [N/s]
    ("torque_rate", "f8"),  # the same [N·m/s]
    ("commanded", "f8", (6,)),  # part of the world's wrench that a client commands in this tick [N, N·m]
    ("session", "f8"),  # of the client whose force is rendered
    ("mapping", "f8"),  # number of that client's mapping
    ("client", "f8", (6,)),  # a client's wrench as rendered [N, N·m]
    ("world", "f8", (6,)),  # the wrench of the world without it, as rendered [N, N·m]
    ("leaving", "?"),  # another world takes over: the wrench goes to zero
    ("arriving", "?"),  # and then to what the world gives now
    ("wanted", "f8", (6,)),  # both together [N, N·m]
)

HEAT = fields(
    ("hottest", "f8"),  # winding [K]; NaN if any is
    ("remaining", "f8"),  # time until a winding reaches `derate` under the present load [s]; inf if never
    ("remaining_age", "f8"),  # time since `remaining` was computed [s]
    ("pending", "f8"),  # time of ticks in which nothing could be read [s]
    ("started", "?"),  # whether a first reading was seen
    ("derate", "f8"),  # winding temperature from which on current is taken away [K]
    ("stop", "f8"),  # winding temperature at which the coils are switched off [K]
    ("coefficient", "f8"),  # of the resistance [1/K]
    ("reference", "f8"),  # temperature of the resistances [K]
    ("ambient", "f8"),  # [K]
    ("winding_capacity", "f8"),  # [J/K]
    ("body_capacity", "f8"),  # [J/K]
    ("winding_to_body", "f8"),  # [W/K]
    ("body_to_air", "f8"),  # [W/K]
    ("tolerance", "f8"),  # relative, of capacities and conductances
    ("core", "f8"),  # temperature of what lies between coupled coils [K]
    ("core_capacity", "f8"),  # [J/K]; 0 where coils are not coupled
)

DRIVE = fields(
    ("supply", "f8"),  # voltage [V]
    ("dt", "f8"),  # time that the last tick took and the next may take [s]
)

PASSIVITY = fields(
    ("energy", "f8"),  # given to the hand since the world began [J]
    ("balance", "f8"),  # what the hand's least damping took less what sampling and delay made [J]
    ("damping", "f8"),  # injected now [N·s/m]
    ("stamp", "f8"),  # when the last counted pose was measured [s]; -inf before the first
    ("newest", "f8"),  # latest stamp so far [s]
    ("predicted", "i8"),  # ticks for which poses are still taken for predictions of the present
    ("count", "i8"),  # wrenches remembered since the start
    ("passive", "?"),  # whether the world is; another one is watched and left alone
    ("arm", "f8"),  # at which a hand holds a mover that turns [m]; 0 where no torque is rendered
    ("pushes", "?"),  # whether force is rendered, not torque alone
    ("dt", "f8"),  # nominal tick [s]
    ("lag", "f8"),  # by which a wrench comes late through the coils [s]
    ("position", "f8", (3,)),  # of the last counted pose [m]
    ("rotation", "f8", (3, 3)),  # of the last counted pose
    ("wrench", "f8", (6,)),  # of the world at the last counted pose [N, N·m]
    ("stored", "f8"),  # energy in the world's memory now [J]; NaN if it does not say
    ("counted", "f8"),  # the same at the last counted pose [J]
    ("world_wrench", "f8", (6,)),  # wrench of the world at the last counted pose, before the guard [N, N·m]
    ("surplus", "f8"),  # made by the world's time step: given and held now, less what it held and was given [J]
    ("motion", "f8", (6,)),  # velocity [m/s] and angular velocity [rad/s] since the pose before
    ("mean", "f8", (6,)),  # wrench asked on average between the last two poses [N, N·m]
    ("times", "f8", (TICKS,)),  # ring: from when on a wrench was asked [s]
    ("wrenches", "f8", (TICKS, 6)),  # ring: which [N, N·m]
)

#: There is one of each.
PROTECTION = fields(
    ("clock", CLOCK),
    ("estimate", ESTIMATE),
    ("guard", GUARD),
    ("heat", HEAT),
    ("drive", DRIVE),
    ("passivity", PASSIVITY),
)

#: Of each coil.
COIL = fields(
    # settings, as the device file says
    ("limit", "f8"),  # current [A]
    ("broken", "f8"),  # current at which wiring or driver must be broken [A]
    ("voltage", "f8"),  # of the supply [V]
    ("cold", "f8"),  # resistance at the reference temperature [Ω]
    ("reference", "f8"),  # temperature [K]
    ("coefficient", "f8"),  # [1/K]
    ("inductance", "f8"),  # [H]
    ("least", "f8"),  # resistance that the winding can have [Ω]
    ("greatest", "f8"),  # resistance that the winding can have [Ω]
    ("to_core", "f8"),  # heat conductance from winding to core [W/K]; 0 where coils are not coupled
    ("hot", "f8"),  # resistance at the stop temperature [Ω]
    ("learnable", "f8"),  # current above which the resistance is learned [A]
    # this tick
    ("current", "f8"),  # measured [A]
    ("boundary", "f8"),  # temperature measured [K]
    ("applied", "f8"),  # duty since the last tick
    ("wrench", "f8", (6,)),  # on the mover per ampere [N/A, N·m/A]
    ("emf", "f8"),  # voltage that the moving mover induces [V]
    # guard
    ("held", "f8"),  # current that may flow [A]
    # heat
    ("winding", "f8"),  # temperature [K]
    ("body", "f8"),  # temperature [K]
    ("heating", "f8"),  # i²R at the reference temperature, mean of this tick [W]
    ("load", "f8"),  # i²R at the reference temperature, averaged [W]
    ("heat_current", "f8"),  # measured when the heat was last observed [A]
    ("ahead_winding", "f8"),  # temperature in the future, while the time that is left is computed [K]
    ("ahead_body", "f8"),  # [K]
    ("free", "f8"),  # that winding if the core were at zero [K]
    ("share", "f8"),  # of the core's temperature in that winding's
    ("body_free", "f8"),  # that body if its winding were at zero [K]
    ("body_share", "f8"),  # of the winding's temperature in that body's
    # drive
    ("resistance", "f8"),  # as learned [Ω]
    ("duty", "f8"),  # chosen in this tick, −1 to 1
    ("driven", "f8"),  # current that should flow at the end of the tick [A]
    ("drive_current", "f8"),  # measured when the resistance was last learned [A]
    ("drive_emf", "f8"),  # emf when the last duties were chosen [V]
    ("volts", "f8"),  # sliding mean of voltage times current [V·A]
    ("squares", "f8"),  # sliding mean of current squared [A²]
    # check of the measured currents
    ("ratio", "f8"),  # learned over expected resistance
    ("model", "f8"),  # current at the last tick [A]
    ("model_before", "f8"),  # where the interval before the last tick began [A]
    ("model_end", "f8"),  # where the interval before the last tick aimed at [A]
    ("model_time", "f8"),  # length of that interval [s]
    ("model_emf", "f8"),  # emf at the last tick [V]
    ("residual", "f8"),  # smoothed difference of measured and model [A]
    ("level", "f8"),  # smoothed magnitude of the current [A]
    ("change", "f8"),  # smoothed change of the current per tick [A]
)


def make_state(device: Device, dt: float, arm: float = 0.0, lag: float = 0.0) -> Records:
    """(1,) PROTECTION for `device` and ticks `dt` [s] apart: off, nothing seen yet.

    arm: at which a hand holds a mover that turns [m]; lag: by which a wrench comes late through the coils [s].
    """
    limits, coils = device.limits, device.coils
    thermal = coils.heat
    state = np.zeros(1, dtype=PROTECTION)
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
    passivity["balance"], passivity["passive"], passivity["pushes"] = CREDIT, True, True
    passivity["stamp"] = passivity["newest"] = -np.inf
    return state


def make_coils(device: Device) -> Records:
    """(m,) COIL for `device`: at ambient temperature and without current."""
    coils = device.coils
    ambient = np.full(device.channels, coils.heat.ambient)
    made = np.zeros(device.channels, dtype=COIL)
    made["limit"], made["broken"] = coils.current_limit, _OVERCURRENT * coils.current_limit
    made["learnable"] = _LEARN * coils.current_limit
    made["voltage"] = device.supply.voltage
    made["cold"], made["inductance"] = coils.resistance, coils.inductance
    made["reference"], made["coefficient"] = coils.reference_temperature, coils.temperature_coefficient
    made["hot"] = device.greatest_resistance
    made["least"] = coils.resistance_at(np.full(device.channels, _COLDEST))
    made["greatest"] = coils.resistance_at(np.full(device.channels, _HOTTEST))
    made["to_core"] = 0.0 if coils.heat.coupling is None else coils.heat.coupling.winding_to_core
    made["resistance"] = coils.resistance_at(ambient)
    made["winding"] = made["body"] = ambient
    made["ratio"] = 1.0
    return made
