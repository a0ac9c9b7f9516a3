"""Simulation of a haptic arm and the hand on it, behind the driver interface.

The end effector is a mass with dry and viscous friction between mechanical stops; the motors' currents follow their
voltages with a first-order lag (L/R), against the back-EMF, and warm the windings; encoders are quantised, and velocity
is the difference quotient of their readings. A gripper is simulated separately (`gripper`). Neglected: torque ripple,
link flexibility, gravity (compensated).
"""

from __future__ import annotations

from collections import deque
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, Record, Records, check_finite, fields, vectors
from haptorb.compiled import kernel
from haptorb.devices.arm import Arm
from haptorb.devices.base import State
from haptorb.errors import DriverError, InputError
from haptorb.estimation.types import Pose, Sample
from haptorb.simulation.base import CoilSimulation
from haptorb.simulation.coil_array import quantise_reading
from haptorb.simulation.coil_circuits import coil_step, cold_coils
from haptorb.simulation.gripper import SimulatedGripper
from haptorb.simulation.noise_generator import seed_noise
from haptorb.simulation.tool_dynamics import GRIP, fill_remaining_rotation, matrix, set_goal

__all__ = ["ARM", "SimulatedArm", "advance_arm"]

_STEP_S = 1e-4  #: of the simulation [s]

#: State of a simulated arm except its motors.
ARM = fields(
    ("mass", "f8"),  # end effector and hand [kg]
    ("inertia", "f8"),  # [kg·m²]
    ("coulomb", "f8"),  # [N]
    ("viscous", "f8"),  # [N·s/m]
    ("turn_coulomb", "f8"),  # [N·m]
    ("turn_viscous", "f8"),  # [N·m·s/rad]
    ("turns", "?"),  # the orientation is free
    ("half", "f8", (3,)),  # of the workspace [m]
    ("round", "?"),  # the workspace is a cylinder about y
    ("stop_stiffness", "f8"),  # [N/m]
    ("stop_damping", "f8"),  # [N·s/m]
    ("grip", GRIP),
    ("goal", "f8", (3,)),  # position to which the hand pulls [m]
    ("goal_q", "f8", (4,)),  # quaternion to which the hand turns
    ("p", "f8", (3,)),  # [m]
    ("q", "f8", (4,)),
    ("v", "f8", (3,)),  # [m/s]
    ("w", "f8", (3,)),  # [rad/s], stator frame
    ("dt", "f8"),  # of a step [s]
    ("steps", "i8"),  # in one call
    ("heat", "f8", (2, 3)),  # `TwoNode.step` of a step
    ("wrench", "f8", (6,)),  # of the motors, mean of the last call [N, N·m]
)


@kernel
def _push_back(arm: Record, dt: float, out: Array) -> None:
    """Add the stops' force [N] in the middle of a step of `dt` [s] to out (6,): springs and dampers that never pull."""
    v, half = arm.v, arm.half
    x, y, z = arm.p[0] + 0.5 * dt * v[0], arm.p[1] + 0.5 * dt * v[1], arm.p[2] + 0.5 * dt * v[2]
    middle = (x, y, z)
    for i in range(3):
        if arm.round and i != 1:
            continue
        side = 1.0 if middle[i] > 0.0 else -1.0
        depth = side * middle[i] - half[i]
        if depth > 0.0:
            out[i] -= side * max(arm.stop_stiffness * depth + arm.stop_damping * side * v[i], 0.0)
    if arm.round:
        r = np.sqrt(x * x + z * z)
        depth = r - half[0]
        if depth > 0.0:
            outwards = (x * v[0] + z * v[2]) / r
            push = max(arm.stop_stiffness * depth + arm.stop_damping * outwards, 0.0)
            out[0] -= push * x / r
            out[2] -= push * z / r


@kernel
def _stick(v: Array, least: float) -> None:
    """Subtract the impulse of dry friction, at most `least`, from v (3,): it can stop a motion, but not reverse it."""
    size = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    share = 0.0 if size <= least else 1.0 - least / size
    for i in range(3):
        v[i] *= share


@kernel
def _turn(q: Array, w: Array, dt: float) -> None:
    """Rotate the quaternion q (4,) by w (3,) [rad/s] in the stator's frame over dt [s]."""
    rate = np.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    half = 0.5 * rate * dt
    s = np.sin(half) / rate if half > 1e-8 else 0.5 * dt
    a, b, c, d = s * w[0], s * w[1], s * w[2], np.cos(half)
    x, y, z, r = q[0], q[1], q[2], q[3]
    nx = d * x + a * r + b * z - c * y
    ny = d * y - a * z + b * r + c * x
    nz = d * z + a * y - b * x + c * r
    nr = d * r - a * x - b * y - c * z
    length = np.sqrt(nx * nx + ny * ny + nz * nz + nr * nr)
    q[0], q[1], q[2], q[3] = nx / length, ny / length, nz / length, nr / length


@kernel
def advance_arm(arm: Records, coils: Records, duties: Array, goal_p: Array, goal_q: Array, per_ampere: Array) -> None:
    """Advance `arm` (1,) ARM and `coils` (m,) COIL by several steps of motors, end effector, stops and hand.

    duties (m,); per_ampere (6, m) [N/A, N·m/A]. Each step is the implicit midpoint in the hand's spring and all
    dampers, (m + d) v' = (m − d) v + dt (F + k (g − p)) with d = dt (c + b)/2 + dt² k/4, less the impulse of dry
    friction; p' = p + dt (v + v')/2.
    """
    e = arm[0]
    set_goal(e, goal_p, goal_q)
    dt, truth, grip = e.dt, e.wrench, e.grip
    total, turn = np.empty(6), np.empty(3)
    for k in range(coils.size):
        coils[k].duty = duties[k]
    truth[:] = 0.0
    drag = 0.5 * dt * (grip.damping + e.viscous) + 0.25 * dt * dt * grip.stiffness
    turn_drag = 0.5 * dt * (grip.turn_damping + e.turn_viscous) + 0.25 * dt * dt * grip.turn_stiffness
    before = np.empty(3)
    for _ in range(e.steps):
        for k in range(coils.size):  # the power that leaves the motor's circuit equals the power delivered to the hand
            emf = 0.0
            for i in range(3):
                emf += per_ampere[i, k] * e.v[i] + per_ampere[3 + i, k] * e.w[i]
            coils[k].emf = emf
        coil_step(coils, e.heat, dt)
        for i in range(6):
            total[i] = 0.0
            for k in range(coils.size):
                total[i] += per_ampere[i, k] * coils[k].mean
            truth[i] += total[i] / e.steps
        _push_back(e, dt, total)
        for i in range(3):
            before[i] = e.v[i]
            pull = total[i] + grip.stiffness * (e.goal[i] - e.p[i])
            e.v[i] = ((e.mass - drag) * e.v[i] + dt * pull) / (e.mass + drag)
        _stick(e.v, dt * e.coulomb / (e.mass + drag))
        for i in range(3):
            e.p[i] += 0.5 * dt * (before[i] + e.v[i])
        if e.turns:
            fill_remaining_rotation(e.q, e.goal_q, turn)
            for i in range(3):
                before[i] = e.w[i]
                pull = total[3 + i] + grip.turn_stiffness * turn[i]
                e.w[i] = ((e.inertia - turn_drag) * e.w[i] + dt * pull) / (e.inertia + turn_drag)
            _stick(e.w, dt * e.turn_coulomb / (e.inertia + turn_drag))
            for i in range(3):
                before[i] = 0.5 * (before[i] + e.w[i])
            _turn(e.q, before, dt)


@final
class SimulatedArm(CoilSimulation):
    """Simulation of motors, end effector and hand of `device`.

    held=False: no hand on the end effector.

    >>> from haptorb.devices.loader import load
    >>> simulated = SimulatedArm(load("arm"))
    >>> for _ in range(2000):
    ...     simulated.advance(1e-3, np.zeros(3), np.array([0.01, 0, 0]), np.array([0, 0, 0, 1.0]))
    >>> bool(1e-4 < abs(simulated.state().p[0] - 0.01) < 1e-3)  # dry friction holds it off the hand's goal
    True
    """

    def __init__(self, device: Arm, seed: int = 0, *, held: bool = True) -> None:
        self.device: Arm = device
        seed_noise(seed)  # rejects an invalid specimen number
        super().__init__(np.zeros(1, dtype=ARM), cold_coils(device), _STEP_S, device.supply.duty_bits)
        state, effector, workspace = self._state, device.effector, device.workspace
        hand = device.hand if held else None
        state["mass"] = effector.mass + (0.0 if hand is None else hand.mass)
        for name in ("inertia", "coulomb", "viscous", "turn_coulomb", "turn_viscous"):
            state[name] = getattr(effector, name)
        state["turns"] = effector.orientation != "fixed"
        state["half"], state["round"] = workspace.half, workspace.shape == "cylinder"
        state["stop_stiffness"], state["stop_damping"] = device.stops.stiffness, device.stops.damping
        if hand is not None:
            for name in ("stiffness", "damping", "turn_stiffness", "turn_damping"):
                state["grip"][name] = getattr(hand, name)
        self._matrix = device.matrix
        self.gripper = None if device.gripper is None else SimulatedGripper(device.gripper)
        self._read: deque[tuple[float, Array]] = deque()
        self.reset(seed)

    def reset(self, seed: int = 0) -> None:
        """Reset: cold motors without currents, the end effector at rest at the origin, noise from `seed`."""
        self._noise = np.random.default_rng(seed)
        self._coils = cold_coils(self.device)
        self._state["wrench"] = 0.0
        self._t = 0.0
        if self.gripper is not None:
            self.gripper.reset()
        self.place(self.device.rest_position, (0.0, 0.0, 0.0, 1.0))

    def place(self, p: ArrayLike, q: ArrayLike) -> None:
        """Place the end effector at `p` (3,) [m] with quaternion `q` (4,), at rest, clipped to the workspace; a fixed
        orientation does not change. Raises InputError for an invalid position or quaternion."""
        at, turned = vectors(p, "p"), check_finite(q, "q")
        if at.shape != (3,) or turned.shape != (4,) or not turned.any():
            raise InputError(f"p must be a position, shape (3,), q a quaternion, shape (4,); got {p!r}, {q!r}")
        state, (x, y, z) = self._state, self.device.workspace.half
        inside = np.clip(at, (-x, -y, -z), (x, y, z))
        if self.device.workspace.shape == "cylinder":
            inside[[0, 2]] *= min(1.0, x / max(float(np.hypot(inside[0], inside[2])), 1e-12))
        state["p"], state["v"], state["w"] = inside, 0.0, 0.0
        free = self.device.effector.orientation != "fixed"
        state["q"] = turned / np.linalg.norm(turned) if free else (0.0, 0.0, 0.0, 1.0)
        state["goal"], state["goal_q"] = at, state["q"]
        self._read.clear()

    def _fill_heat(self, dt: float) -> None:
        self._state["heat"] = self.device.coils.heat.coil.step(dt)

    def advance(self, dt: float, duties: Array, goal_p: Array, goal_q: Array) -> None:
        """Advance by `dt` [s]; a goal that is not finite leaves the hand's last one.

        Raises InputError for less than 0 or more than 10 s.
        """
        if self._set_steps(dt):
            advance_arm(self._state, self._coils, duties, goal_p, goal_q, self._matrix)
            self._t += dt

    def sample(self, t: float, pose_stamp: float, pose_valid: bool) -> Sample:
        """Read every sensor once: the pose quantised by the encoders, velocity as its difference quotient.

        The angular velocity is the true one. Raises DriverError if the simulated state is not finite.
        """
        device, coils, state = self.device, self._coils, self.state()
        if not np.isfinite(state.p @ state.p + state.v @ state.v + state.w @ state.w):
            raise DriverError(
                "the simulated arm's state is not finite: a value of the device file is unrealistic; compare effector, "
                "stops and hand with the file of 'arm'"
            )
        noise = self._noise.standard_normal((2, device.channels))
        current = quantise_reading(
            coils["current"] + device.supply.current_noise * noise[0], device.supply.current_step
        )
        warmth = quantise_reading(coils["body"] + device.thermometer_noise * noise[1], device.thermometer_step)
        p = quantise_reading(state.p, device.encoder.step)
        pose = Pose(pose_stamp, self._sense_rotation(state.R_SR), p, state.w, self._differ(t, p), pose_valid)
        opening, rate = (np.nan, np.nan) if self.gripper is None else self.gripper.read(t)
        return Sample(t, current, warmth, np.empty((0, 3)), pose, gripper=opening, gripper_velocity=rate)

    def _differ(self, t: float, p: Array) -> Array:
        """Velocity (3,) [m/s]: displacement since the oldest position in the window, at `t` [s] and `p` (3,) [m]."""
        read = self._read
        if read and read[-1][0] >= t:
            read.pop()
        while len(read) > 1 and t - read[1][0] >= self.device.encoder.velocity_window - 1e-9:
            read.popleft()
        before = read[0] if read else None
        read.append((t, p))
        if before is None or before[0] >= t:
            return np.zeros(3)
        velocity: Array = (p - before[1]) / (t - before[0])
        return velocity

    def _sense_rotation(self, R: Array) -> Array:
        """R (3, 3) quantised by the wrist's encoders: the components of its rotation vector."""
        step = self.device.encoder.turn_step
        if not step or self.device.effector.orientation == "fixed":
            return R
        x, y, z, w = self._state["q"][0]
        s = float(np.sqrt(x * x + y * y + z * z))
        vector = (2.0 * np.arctan2(s, w) / s if s > 1e-12 else 2.0) * np.array([x, y, z])
        vector = quantise_reading(vector, step)
        angle = float(np.linalg.norm(vector))
        half = 0.5 * angle
        scale = np.sin(half) / angle if angle > 1e-12 else 0.5
        sensed = np.empty((3, 3))
        matrix(np.array([*(scale * vector), np.cos(half)]), sensed)
        return sensed

    def wrench_actual(self) -> Array:
        """(6,) mean wrench of the motors on the end effector over the last `advance` [N, N·m], without friction."""
        wrench: Array = self._state["wrench"][0].copy()
        return wrench

    def state(self) -> State:
        """True state of the end effector."""
        state, R = self._state, np.empty((3, 3))
        p, q, v, w = (state[name][0].copy() for name in "pqvw")
        matrix(q, R)
        return State(self._t, R, p, w, v)
