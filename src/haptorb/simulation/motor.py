"""Simulation of a spherical motor with a hand on its handle, behind the driver interface.

The motor is a random specimen within the tolerances of its file (`motor_specimen`), unknown to the controller. The
coils have inductance, warm up, and a back-EMF from the same torque per ampere that converts currents to torque; weight
and regulator act on the rotor; the bearing has friction, and the rotor has an end stop at the edge of its workspace; 48
imperfect Hall sensors measure the field of magnets and coils. Not modelled: eddy currents (all parts but the magnets
are non-magnetic, and the frame is assumed to be non-conducting), mutual inductance of the coils, the chopper's ripple,
and the bearing's clearance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from math import cos
from typing import final

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from haptorb.arrays import Array, Record, Records, check_finite, fields
from haptorb.compiled import kernel
from haptorb.devices.base import State
from haptorb.devices.field_sensors import SensorErrors, draw_sensors
from haptorb.devices.motor import Grasp, SphericalMotor
from haptorb.devices.weight_regulator import torque_over_sine
from haptorb.errors import DriverError, InputError
from haptorb.estimation.types import Pose, Sample
from haptorb.simulation.base import CoilSimulation
from haptorb.simulation.coil_circuits import coil_step, cold_coils
from haptorb.simulation.hall_sensors import let_fail, make_halls, quantise, read_halls
from haptorb.simulation.motor_specimen import (
    MotorTruth,
    draw_motor,
    fill_field,
    fill_torque,
    pack_truth,
    unpack_truth,
)
from haptorb.simulation.noise_generator import fill_normal, seed_noise
from haptorb.simulation.tool_dynamics import fill_remaining_rotation, matrix

__all__ = [
    "MOTOR",
    "ROTOR",
    "STRIDE_RAD",
    "SimulatedMotor",
    "advance",
    "angular_velocity",
    "kick",
    "limit_tilt",
    "make_rotor_record",
    "potential_energy",
    "sense",
    "turn",
]


# --------------------------------------------------------------------------------------------------
# Rotor on a ball joint as a rigid body: gravity, regulator, bearing friction, hand and end stop.
#
# A step is a free rotation for half of it, one impulse by all torques, and the other half of the rotation. The free
# rotation is composed of rotations about the three principal axes, each exact: it conserves the angular momentum to
# rounding and its energy error does not grow. Springs and weight have potentials; dampers and friction only dissipate:
# a damper is integrated as an exact exponential, dry friction stops a motion within a step but cannot reverse it.


#: Rotor, its bearing and the hand on its handle.
ROTOR = fields(
    ("inertia", "f8", (3,)),  # principal moments about the centre, with the hand's mass, rotor frame [kg·m²]
    ("damping", "f8", (3,)),  # bearing and hand, about the rotor's axes [N·m·s/rad]
    ("friction", "f8"),  # dry, of the bearing [N·m]
    ("grip", "f8"),  # spring of the hand towards its goal [N·m/rad]
    ("least", "f8"),  # minimum cos(tilt) of the known torque of weight and regulator
    ("edge", "f8"),  # cosine of the tilt at which the end stop begins
    ("stop", "f8"),  # its stiffness [N·m/rad]
    ("stop_damping", "f8"),  # [N·m·s/rad]
    ("goal", "f8", (4,)),  # quaternion of the hand's goal
    ("q", "f8", (4,)),  # quaternion of R_SR (x, y, z, w)
    ("momentum", "f8", (3,)),  # angular, rotor frame [N·m·s]
)


@kernel
def angular_velocity(momentum: Array, inertia: Array, R: Array, w: Array) -> None:
    """Fill w (3,) [rad/s], stator frame, for the momentum (3,) of a ROTOR at R (3, 3)."""
    a, b, c = momentum[0] / inertia[0], momentum[1] / inertia[1], momentum[2] / inertia[2]
    for i in range(3):
        w[i] = R[i, 0] * a + R[i, 1] * b + R[i, 2] * c


@kernel
def _rotate_about_axis(q: Array, momentum: Array, axis: int, dt: float, inertia: Array) -> None:
    """Rotate freely about one principal axis: the momentum, fixed in space, rotates back in the rotor's frame."""
    angle = dt * momentum[axis] / inertia[axis]
    c, s = np.cos(angle), np.sin(angle)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    mj, mk = momentum[j], momentum[k]
    momentum[j], momentum[k] = c * mj + s * mk, c * mk - s * mj
    c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
    qi, qj, qk, qw = q[axis], q[j], q[k], q[3]
    q[axis], q[j], q[k], q[3] = c * qi + s * qw, c * qj + s * qk, c * qk - s * qj, c * qw - s * qi


@kernel
def turn(q: Array, momentum: Array, inertia: Array, dt: float) -> None:
    """Advance a free rigid body by `dt` [s]: Strang splitting of three exact rotations, symplectic, second order."""
    half = 0.5 * dt
    _rotate_about_axis(q, momentum, 0, half, inertia)
    _rotate_about_axis(q, momentum, 1, half, inertia)
    _rotate_about_axis(q, momentum, 2, dt, inertia)
    _rotate_about_axis(q, momentum, 1, half, inertia)
    _rotate_about_axis(q, momentum, 0, half, inertia)
    size = np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    for i in range(4):
        q[i] /= size


@kernel
def kick(rotor: Record, coefficients: Array, R: Array, passive: Array, coils: Array, dt: float) -> float:
    """Apply `dt` [s] of torque to a ROTOR at the orientation R; returns the deflection of the end stop [rad].

    passive (3,) is filled with the torque of weight and regulator, whose `coefficients` (n,) `torque_over_sine`
    takes; coils (3,) is that of the currents [N·m].
    """
    momentum, inertia = rotor.momentum, rotor.inertia
    nx, ny, nz = R[0, 2], R[1, 2], R[2, 2]
    back = torque_over_sine(nz, coefficients, rotor.least)
    passive[0], passive[1], passive[2] = back * ny, -back * nx, 0.0  # back · ẑ_R × Ẑ
    left = np.empty(3)
    fill_remaining_rotation(rotor.q, rotor.goal, left)
    total = np.empty(3)
    for i in range(3):
        total[i] = passive[i] + coils[i] + rotor.grip * left[i]
    pressed = 0.0
    if nz < rotor.edge:
        lean = np.sqrt(nx * nx + ny * ny)
        pressed = np.arctan2(lean, nz) - np.arccos(rotor.edge)
        ux, uy = ny / lean, -nx / lean  # axis of the rotation to upright
        w = np.empty(3)
        angular_velocity(momentum, inertia, R, w)
        push = rotor.stop * pressed - rotor.stop_damping * (w[0] * ux + w[1] * uy)
        # A damper that would reverse the motion within a step is limited, and a stop never pulls.
        push = max(push, 0.0)
        total[0] += push * ux
        total[1] += push * uy
    for i in range(3):
        momentum[i] += dt * (R[0, i] * total[0] + R[1, i] * total[1] + R[2, i] * total[2])
        momentum[i] *= np.exp(-dt * rotor.damping[i] / inertia[i])
    a, b, c = momentum[0] / inertia[0], momentum[1] / inertia[1], momentum[2] / inertia[2]
    rate = np.sqrt(a * a + b * b + c * c)
    if rate > 0.0:
        a, b, c = a / rate, b / rate, c / rate
        yielding = a * a / inertia[0] + b * b / inertia[1] + c * c / inertia[2]
        rub = min(dt * rotor.friction, rate / yielding)
        momentum[0] -= rub * a
        momentum[1] -= rub * b
        momentum[2] -= rub * c
    return pressed


# --------------------------------------------------------------------------------------------------
# Physics of a motor in compiled code: steps of rotor and coils, and one reading of every sensor.


STRIDE_RAD = 5e-3  #: rotation [rad] over which one torque characteristic is used: K varies over tenths of a radian

#: State and settings of a simulated motor except its coils and field sensors.
MOTOR = fields(
    ("rotor", ROTOR),
    ("dt", "f8"),  # of a step [s]
    ("steps", "i8"),  # in one call
    ("heat", "f8", (2, 3)),  # `TwoNode.step` of a step
    ("torque", "f8", (3,)),  # of coils, weight and regulator on the rotor, mean of the last call [N·m]
    ("pressed", "f8"),  # deflection of the end stop [rad]
    ("current_noise", "f8"),  # [A]
    ("current_step", "f8"),  # [A]
    ("warming", "f8"),  # temperature rise of the sensors relative to that of the coils at their boundary
    ("heat_noise", "f8"),  # [K]
    ("heat_step", "f8"),  # [K]
    ("generator", "u8", (4,)),  # of the sensors' noise
)


@kernel
def advance(motor: Records, coils: Records, magnetics: Array, strength: Array, duties: Array, goal: Array) -> None:
    """Advance `motor` (1,) MOTOR and `coils` (m,) COIL by several steps of rotor and coils.

    The torque per ampere changes little from step to step: it is evaluated once per rotation by STRIDE_RAD, at its
    midpoint.

    magnetics as `pack_truth` made them; strength (p,) of the magnets; duties (m,); the hand moves to goal (4,) if
    it is valid, else to its last goal.
    """
    m, parts = motor[0], unpack_truth(magnetics)
    rotor, truth, dt, steps, channels = m.rotor, m.torque, m.dt, m.steps, coils.size
    R, w, K = np.empty((3, 3)), np.empty(3), np.empty((3, channels))
    passive, given, mean = np.empty(3), np.empty(3), np.empty(channels)
    size = goal[0] * goal[0] + goal[1] * goal[1] + goal[2] * goal[2] + goal[3] * goal[3]
    if 0.0 < size < 1e12:  # false for NaN as well
        for i in range(4):
            rotor.goal[i] = goal[i] / math.sqrt(size)
    for k in range(channels):
        coils[k].duty = duties[k]
    for i in range(3):
        truth[i] = 0.0
    held = 0
    for step in range(steps):
        if held == 0:
            held = _stride(rotor, dt, steps - step)
            _characteristic(rotor, 0.5 * held * dt, parts, strength, K)
        held -= 1
        turn(rotor.q[:], rotor.momentum[:], rotor.inertia[:], 0.5 * dt)
        matrix(rotor.q[:], R)
        angular_velocity(rotor.momentum[:], rotor.inertia[:], R, w)
        for k in range(channels):  # the power that leaves the coil's circuit equals the power delivered to the rotor
            coils[k].emf = K[0, k] * w[0] + K[1, k] * w[1] + K[2, k] * w[2]
        coil_step(coils, m.heat, dt)
        for k in range(channels):
            mean[k] = coils[k].mean
        for i in range(3):
            given[i] = 0.0
            for k in range(channels):
                given[i] += K[i, k] * mean[k]
        m.pressed = kick(rotor, parts.tilt_torque, R, passive, given, dt)
        for i in range(3):
            truth[i] += (given[i] + passive[i]) / steps
        turn(rotor.q[:], rotor.momentum[:], rotor.inertia[:], 0.5 * dt)


@kernel
def _stride(rotor: Record, dt: float, most: int) -> int:
    """Number of steps of `dt` [s], 1 to `most`, until the rotor has rotated by STRIDE_RAD."""
    momentum, inertia = rotor.momentum, rotor.inertia
    a, b, c = momentum[0] / inertia[0], momentum[1] / inertia[1], momentum[2] / inertia[2]
    turned = dt * math.sqrt(a * a + b * b + c * c)
    if not turned * most > STRIDE_RAD:  # also if its state is not finite
        return most
    return max(int(STRIDE_RAD / turned), 1)


@kernel
def _characteristic(rotor: Record, ahead: float, parts: MotorTruth, strength: Array, K: Array) -> None:
    """Fill K (3, m) [N·m/A] as predicted `ahead` [s] from now for a free rotation of the rotor."""
    q, momentum, R = rotor.q.copy(), rotor.momentum.copy(), np.empty((3, 3))
    turn(q, momentum, rotor.inertia[:], ahead)
    matrix(q, R)
    fill_torque(parts, strength, R, K)


@kernel
def _is_finite(rotor: Record) -> bool:
    """Whether pose and momentum of a ROTOR are finite."""
    total = rotor.q[3]
    for i in range(3):
        total += rotor.q[i] + rotor.momentum[i]
    return bool(np.isfinite(total))


@kernel
def sense(
    motor: Records, coils: Records, halls: Records, magnetics: Array, strength: Array, pose: Array, read: Array,
    field: Array,
) -> bool:  # fmt: skip
    """Read every sensor once, and the rotor's true motion; False, without a reading, if it is not finite.

    motor, coils, magnetics and strength as in `advance`; halls (k,) HALL; pose (4, 3) becomes R and w; read (2 m,)
    currents [A], then temperatures [K]; field (k, 3) [T].
    """
    m, parts, channels = motor[0], unpack_truth(magnetics), coils.size
    rotor = m.rotor
    if not _is_finite(rotor):
        return False
    matrix(rotor.q[:], pose[:3])
    angular_velocity(rotor.momentum[:], rotor.inertia[:], pose[:3], pose[3])
    draws = np.empty(2 * channels)
    fill_normal(m.generator, draws)
    for k in range(channels):
        read[k] = quantise(coils[k].current + m.current_noise * draws[k], m.current_step)
        read[channels + k] = quantise(coils[k].body + m.heat_noise * draws[channels + k], m.heat_step)
    fill_field(parts, strength, pose[:3], field)
    total_field, coil_field = field.reshape(-1), parts.coil_field
    for j in range(channels):
        ampere = coils[j].current
        for r in range(total_field.shape[0]):
            total_field[r] += coil_field[j, r] * ampere
    warmth = 0.0
    for j in range(channels):
        warmth += m.warming * (coils[j].body - coils[j].ambient) / channels
    read_halls(halls, m.generator, warmth, field)
    return True


# --------------------------------------------------------------------------------------------------
# Rotor's joint from device and hand, its potential energy, and the limit of its workspace.


def make_rotor_record(device: SphericalMotor, grasp: Grasp) -> Records:
    """(1,) ROTOR of `device` with the hand `grasp` on its handle: upright and at rest."""
    rotor, made = device.rotor, np.zeros(1, dtype=ROTOR)
    arm = rotor.handle_length
    hand = np.array([grasp.mass * arm**2, grasp.mass * arm**2, 0.5 * grasp.mass * grasp.radius**2])
    made["inertia"] = np.array(rotor.inertia, dtype=np.float64) + hand
    made["damping"] = float(rotor.viscous_friction) + grasp.damping * arm**2
    made["friction"], made["grip"] = rotor.dry_friction, grasp.stiffness * arm**2
    made["edge"] = cos(device.workspace_tilt)
    made["stop"], made["stop_damping"] = device.end_stop.stiffness, device.end_stop.damping
    made["q"] = made["goal"] = (0.0, 0.0, 0.0, 1.0)
    return made


def potential_energy(coefficients: Array, least: float, cosine: float) -> float:
    """Potential of weight and regulator [J]: dU/d(cos) = −(torque over sin), which the coefficients (n,) give."""

    def integral(c: float) -> float:
        x = (2 * c - (1 + least)) / (1 - least)
        return 0.5 * (1 - least) * float(chebyshev.chebval(x, chebyshev.chebint(coefficients)))

    beyond = max(least - cosine, 0.0) * float(chebyshev.chebval(-1.0, coefficients))
    return integral(1.0) - integral(max(cosine, least)) + beyond


def limit_tilt(q: Array, tilt: float) -> Array:
    """Limit the tilt of `q` to `tilt` about the same axis; the spin does not change.

    Quaternions (4,), `tilt` in [rad].
    """
    R = np.empty((3, 3))
    matrix(q, R)
    nx, ny, nz = R[:, 2].tolist()
    lean = np.arctan2((nx * nx + ny * ny) ** 0.5, nz)
    if lean <= tilt:
        return q
    half = 0.5 * (lean - tilt)
    size = (nx * nx + ny * ny) ** 0.5
    ux, uy = (ny / size, -nx / size) if size > 1e-12 else (1.0, 0.0)
    x, y, z, w = q.tolist()
    a, b, d = np.sin(half) * ux, np.sin(half) * uy, np.cos(half)
    return np.array([d * x + w * a + b * z, d * y + w * b - a * z, d * z + a * y - b * x, d * w - a * x - b * y])


@final
class SimulatedMotor(CoilSimulation):
    """Simulation of coils, magnets, rotor, hand and sensors of `device`, in steps of at most `step` [s].

    seed            number of the specimen, and seed of the sensors' noise
    grasp           hand instead of the device's; HANDLE_LOOSE for none
    quality         constant errors of the field sensors instead of the device's
    magnet_spread   relative standard deviation of the magnets' strengths, in addition to the device's uncertainty

    Raises InputError for a step above 1 ms, or a spread outside 0 to 1.

    >>> from haptorb.devices.motor import HANDLE_LOOSE
    >>> from haptorb.devices.loader import load
    >>> motor = SimulatedMotor(load("pmsm"), seed=1, grasp=HANDLE_LOOSE)
    >>> upright = np.array([0, 0, 0, 1.0])
    >>> for _ in range(20):
    ...     motor.advance(1e-3, np.zeros(12), np.zeros(3), upright)
    >>> motor.state().axis.tolist(), motor.sample(0.02, 0.02, True).field.shape
    ([0.0, 0.0, 1.0], (48, 3))
    """

    def __init__(
        self,
        device: SphericalMotor,
        seed: int = 0,
        *,
        grasp: Grasp | None = None,
        quality: SensorErrors | None = None,
        magnet_spread: float = 0.0,
        step: float = 2.5e-4,
    ) -> None:
        if not (np.isfinite(step) and 0.0 < step <= 1e-3):
            raise InputError(f"step of the simulation must be above 0 and at most 1 ms; got {step} s")
        if not (np.isfinite(magnet_spread) and 0.0 <= magnet_spread < 1.0):
            raise InputError(f"magnet_spread must be a share from 0 to below 1; got {magnet_spread!r}")
        self.device: SphericalMotor = device
        self.grasp = grasp or device.hand
        self._quality, self._spread = quality or device.hall.errors, float(magnet_spread)
        supply = device.supply
        super().__init__(np.zeros(1, dtype=MOTOR), cold_coils(device), float(step), supply.duty_bits)
        self._still = np.zeros(3)
        self._state["current_noise"], self._state["current_step"] = supply.current_noise, supply.current_step
        self._state["warming"] = device.hall.warming
        self._state["heat_noise"], self._state["heat_step"] = device.thermometer_noise, device.thermometer_step
        self._state["rotor"] = make_rotor_record(device, self.grasp)
        self._rotor, self._torque = self._state["rotor"], self._state["torque"][0]
        self._failures = np.zeros(device.sensors, dtype=np.int64)
        self.reset(seed)

    def reset(self, seed: int = 0) -> None:
        """Reset to motor number `seed`: cold coils, no currents, the rotor upright and at rest, noise from `seed`."""
        self._state["generator"] = seed_noise(seed)
        device, hall = self.device, self.device.hall
        specimen = draw_sensors(self._quality, device.sensors, seed)
        self._halls = make_halls(device.sensor_layout.frames, specimen, hall)
        self._halls["failure"] = self._failures
        self.built = draw_motor(device, seed, specimen.placement)
        self._parts = self.built.compile()
        self._magnetics = pack_truth(self._parts)
        self._state["rotor"]["least"] = self.built.least
        draw = np.random.Generator(np.random.PCG64([seed, 1]))
        self._strength = self.built.strength * (1.0 + self._spread * draw.standard_normal(len(device.polarity)))
        self._coils = cold_coils(device)
        self._rotor["q"] = self._rotor["goal"] = (0.0, 0.0, 0.0, 1.0)
        self._rotor["momentum"] = self._state["torque"] = self._state["pressed"] = 0.0
        self._t = 0.0

    def place(self, p: ArrayLike, q: ArrayLike) -> None:
        """Rotate the rotor to `q` (4,), at rest; beyond the end stop the tilt is limited to it. `p` (3,) is ignored.

        Raises InputError for an invalid quaternion.
        """
        turned = check_finite(q, "q")
        if turned.shape != (4,) or not turned.any():
            raise InputError(f"q must be a quaternion (x, y, z, w) that is not zero; got {q!r}")
        self._rotor["q"] = limit_tilt(turned / np.linalg.norm(turned), self.device.workspace_tilt)
        self._rotor["momentum"] = 0.0
        self._rotor["goal"] = turned / np.linalg.norm(turned)

    def spin(self, w: ArrayLike) -> None:
        """Set the rotor's angular velocity to `w` (3,) [rad/s], stator frame. Raises InputError for another shape."""
        rate = check_finite(w, "w")
        if rate.shape != (3,):
            raise InputError(f"w must have shape (3,); got {rate.shape}")
        self._rotor["momentum"] = self._rotor["inertia"] * (self.state().R_SR.T @ rate)

    def fail(self, sensors: Iterable[int], kind: str = "dead") -> None:
        """Make field sensors of these numbers, from 0, fail: "dead", "stuck", "saturated" or "none" (`let_fail`).

        A reset does not repair them.
        """
        let_fail(self._halls, sensors, kind)
        self._failures[:] = self._halls["failure"]

    def _fill_heat(self, dt: float) -> None:
        self._state["heat"] = self.device.coils.heat.coil.step(dt)

    def advance(self, dt: float, duties: Array, goal_p: Array, goal_q: Array) -> None:
        """Advance by `dt` [s]; a goal that is not finite leaves the hand's last one, and `goal_p` is ignored.

        Raises InputError for less than 0 or more than 10 s.
        """
        if self._set_steps(dt):
            advance(self._state, self._coils, self._magnetics, self._strength, duties, goal_q)
            self._t += dt

    def sample(self, t: float, pose_stamp: float, pose_valid: bool) -> Sample:
        """Read every sensor once; the pose is the true one, as from an external tracker.

        Raises DriverError if the simulated state is not finite.
        """
        channels = self.device.channels
        read, pose = np.empty(2 * channels), np.empty((4, 3))
        field = np.empty((self.device.sensors, 3))
        if not sense(self._state, self._coils, self._halls, self._magnetics, self._strength, pose, read, field):
            raise DriverError(
                "the simulated rotor's state is not finite: a value of the device file is unrealistic; "
                "compare rotor and regulator with the file of 'pmsm'"
            )
        tracked = Pose(pose_stamp, pose[:3], self._still, pose[3], self._still, pose_valid)
        return Sample(t, read[:channels], read[channels:], field, tracked)

    def wrench_actual(self) -> Array:
        """(6,) mean wrench over the last `advance`: torque of coils, regulator and weight on the rotor [N·m], without
        hand, bearing and end stop. The bearing carries every force: the first three are zero."""
        wrench = np.zeros(6)
        wrench[3:] = self._torque
        return wrench

    def state(self) -> State:
        """True state of the rotor."""
        R, w = np.empty((3, 3)), np.empty(3)
        rotor = self._rotor
        matrix(rotor["q"][0], R)
        angular_velocity(rotor["momentum"][0], rotor["inertia"][0], R, w)
        return State(self._t, R, np.zeros(3), w, np.zeros(3))

    @property
    def stop_deflection(self) -> float:
        """Present deflection of the end stop [rad]; 0: not reached."""
        return float(self._state["pressed"][0])

    @property
    def momentum(self) -> Array:
        """(3,) angular momentum of rotor and hand, stator frame [N·m·s]."""
        momentum: Array = self.state().R_SR @ self._rotor["momentum"][0]
        return momentum

    @property
    def energy(self) -> float:
        """Kinetic energy, plus potentials of weight, regulator, grip and end stop [J]; zero upright at the hand's
        goal."""
        rotor = self._rotor[0]
        kinetic = 0.5 * float((rotor["momentum"] ** 2 / rotor["inertia"]).sum())
        left = np.empty(3)
        fill_remaining_rotation(rotor["q"], rotor["goal"], left)
        cosine = float(self.state().R_SR[2, 2])
        over = max(np.arccos(min(cosine, 1.0)) - np.arccos(rotor["edge"]), 0.0)
        return float(
            kinetic
            + 0.5 * rotor["grip"] * float(left @ left)
            + 0.5 * rotor["stop"] * float(over) ** 2
            + potential_energy(self._parts.tilt_torque, float(rotor["least"]), cosine)
        )
