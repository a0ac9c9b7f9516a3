"""A spherical motor and a hand on its handle, simulated: what the driver of a real one would meet.

The coils have inductance, warm up, and feel the turning magnets as an electromotive force from the same torque
characteristic that turns currents into torque; weight and regulator act on the rotor; the bearing rubs and the rotor
stops at the edge of its workspace; 48 imperfect Hall sensors see the magnets and the coils. Not modelled: eddy currents
(all parts but the magnets are non-magnetic, and the frame is taken as non-conducting), mutual inductance of the coils,
the chopper's ripple, and the bearing's clearance.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import ceil
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.devices.motor.handle import Grasp, HallQuality
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.devices.state import State
from haptorb.errors import DriverError, InputError, UnknownName
from haptorb.numerics.arrays import Array, finite
from haptorb.physics.thermal import TwoNode
from haptorb.sensing.sample import Pose, Sample
from haptorb.simulation.motor.hall import (
    FAILURES,
    HallFaults,
    halls,
)
from haptorb.simulation.motor.hanging import joint_of, potential_energy, within
from haptorb.simulation.motor.motor_kernels import MeterNoise, Parts, advance, sense
from haptorb.simulation.motor.rotor import ANGULAR, Joint, angular_velocity
from haptorb.simulation.parts.coils import CURRENT, WINDING, chop, cold, wires
from haptorb.simulation.parts.noise import seed_noise
from haptorb.simulation.parts.tool import matrix
from haptorb.simulation.simulation import Simulation

__all__ = ["SimulatedMotor"]


@final
class SimulatedMotor(Simulation):
    """Coils, magnets, rotor, hand and sensors of `device`, in steps of at most `step` [s].

    grasp           another hand than the device's; HANDLE_LOOSE for none
    quality         other lasting errors of the field sensors than the device's
    magnet_spread   relative standard deviation of the magnets' strengths, which no controller knows

    Raises InputError for a step above 1 ms, or a spread that is no share.

    >>> from haptorb.devices.motor.handle import HANDLE_LOOSE
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
        quality: HallQuality | None = None,
        magnet_spread: float = 0.0,
        step: float = 2.5e-4,
    ) -> None:
        if not (np.isfinite(step) and 0.0 < step <= 1e-3):
            raise InputError(f"step of the simulation must be above 0 and at most 1 ms; got {step} s")
        if not (np.isfinite(magnet_spread) and 0.0 <= magnet_spread < 1.0):
            raise InputError(f"magnet_spread must be a share from 0 to below 1; got {magnet_spread!r}")
        self.device: SphericalMotor = device
        self.grasp = grasp or device.hand
        self._quality, self._spread = quality or device.hall_spread, float(magnet_spread)
        self._longest = float(step)
        self._wires = wires(device)
        heat = device.coils.heat
        self._heat = TwoNode(heat.winding_capacity, heat.body_capacity, heat.winding_to_body, heat.body_to_air)
        self._dt, self._steps, self._heat_step = 0.0, 1, np.zeros((2, 3))  # of the last advance
        self._still = np.zeros(3)
        tables = device.tables
        self._parts = Parts(
            tables.torque_pair.cells,
            float(tables.torque_pair.scale),
            tables.field_pair.cells,
            float(tables.field_pair.scale),
            np.array(device.magnets.directions, order="C"),
            np.array(device.polarity, dtype=np.float64),
            np.array(device.electromagnets.directions, order="C"),
            np.array(device.sensor_layout.directions, order="C"),
            np.array(device.groups, dtype=np.float64, order="C"),
            device.sensor_field_per_ampere,
        )
        supply = device.supply
        heat_meter = float(device.thermometer_noise), float(device.thermometer_step)
        self._meters = MeterNoise(float(supply.current_noise), float(supply.current_step), *heat_meter)
        self._hang(joint_of(device, self.grasp))
        self._steps_of_duty = float(2**supply.duty_bits)
        self._torque = np.zeros(3)
        self._goal = np.array([0.0, 0.0, 0.0, 1.0])
        self._faults = HallFaults(np.zeros(device.sensors), np.zeros((device.sensors, 3)))
        self.reset(seed)

    def _hang(self, joint: Joint) -> None:
        """Put the rotor on `joint`."""
        self._joint = joint
        one = (joint.friction, joint.grip, joint.least, joint.edge, joint.stop, joint.stop_damping)
        self._moving = np.array([*self._wires[2:], *one, self._parts.torque_scale])

    def reset(self, seed: int = 0) -> None:
        """Cold coils without currents, the rotor upright and at rest, noise and lasting errors from `seed`."""
        self._noise = seed_noise(seed)
        hall = self.device.hall
        self._halls = halls(self.device.sensor_layout.frames, self._quality, float(hall.noise), float(hall.step), seed)
        draw = np.random.Generator(np.random.PCG64([seed, 1]))
        parts = self._parts
        spread = 1.0 + self._spread * draw.standard_normal(len(parts.strength))
        self._parts = parts._replace(strength=np.array(self.device.polarity, dtype=np.float64) * spread)
        drawn = self._halls
        self._sensing = np.array([*self._meters, drawn.noise, drawn.step, drawn.reach, parts.field_scale])
        self._coils = cold(self._wires)
        self._rotor = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        self._torque[:] = 0.0
        self._goal[:] = self._rotor[:4]
        self._t = 0.0
        self._pressed = 0.0

    def place(self, p: ArrayLike, q: ArrayLike) -> None:
        """Turn the rotor to `q` (4,), at rest; beyond the edge it is set onto the edge. `p` (3,) means nothing here.

        Raises InputError for what is no quaternion.
        """
        turned = finite(q, "q")
        if turned.shape != (4,) or not turned.any():
            raise InputError(f"q must be a quaternion (x, y, z, w) that is not zero; got {q!r}")
        self._rotor[:4] = within(turned / np.linalg.norm(turned), self.device.workspace_tilt)
        self._rotor[ANGULAR:] = 0.0
        self._goal[:] = turned / np.linalg.norm(turned)

    def spin(self, w: ArrayLike) -> None:
        """Give the rotor the angular velocity `w` (3,) [rad/s], stator frame. Raises InputError for another shape."""
        rate = finite(w, "w")
        if rate.shape != (3,):
            raise InputError(f"w must have shape (3,); got {rate.shape}")
        self._rotor[ANGULAR:] = self._joint.inertia * (self.state().R_SR.T @ rate)

    def fail(self, sensors: Iterable[int], kind: str = "dead") -> None:
        """Let field sensors (numbered from 0) fail: "dead" (nothing but offset and noise), "stuck" at the last reading,
        "saturated"; "none" mends them.

        Raises UnknownName for another failure, InputError for a sensor that there is not.
        """
        if kind not in FAILURES:
            raise UnknownName("failure of a sensor", kind, FAILURES)
        for number in sensors:
            if not 0 <= number < self.device.sensors:
                raise InputError(f"sensor {number} does not exist; there are 0 to {self.device.sensors - 1}")
            self._faults.kind[number] = FAILURES[kind]

    def quantise(self, duties: Array) -> Array:
        """(m,) what the chopper makes of `duties` (m,): clipped to −1…1, in its steps; not a number: zero."""
        out = np.empty(self.device.channels)
        chop(np.ascontiguousarray(duties, dtype=np.float64), self._steps_of_duty, out)
        return out

    def advance(self, dt: float, duties: Array, goal_p: Array, goal_q: Array) -> None:
        """Let `dt` [s] pass; a goal that is not finite leaves the hand's last one, and `goal_p` means nothing here.

        Raises InputError for less than 0 or more than 10 s.
        """
        if not (0.0 <= dt < 10.0):
            raise InputError(f"the simulation can advance by 0 to 10 s at once; got {dt} s")
        if dt == 0.0:
            return
        if dt != self._dt:
            steps = max(ceil(dt / self._longest - 1e-9), 1)
            self._dt, self._steps, self._heat_step = dt, steps, self._heat.step(dt / steps)
        wires, joint, parts = self._wires, self._joint, self._parts
        self._pressed = advance(
            self._rotor, self._coils, duties, goal_q, self._goal, self._moving, wires.resistance, wires.inductance,
            self._heat_step, joint.inertia, joint.damping, joint.leaning, parts.torque_cells, parts.magnets,
            parts.strength, parts.coils, parts.groups, dt / self._steps, self._steps, self._torque,
        )  # fmt: skip
        self._t += dt

    def sample(self, t: float, pose_stamp: float, pose_valid: bool) -> Sample:
        """One reading of every sensor; the pose is the true one, as an external tracker would tell it.

        Raises DriverError where the simulation has left the numbers.
        """
        channels, parts, halls, faults = self.device.channels, self._parts, self._halls, self._faults
        read, pose = np.empty(2 * channels), np.empty((4, 3))
        field = np.empty((self.device.sensors, 3))
        if not sense(
            self._rotor, self._coils, self._sensing, self._joint.inertia, parts.field_cells, parts.magnets,
            parts.strength, parts.sensors, parts.coil_field, halls.frames, halls.mixing, halls.offset, faults.kind,
            faults.held, self._noise, pose, read, field,
        ):  # fmt: skip
            raise DriverError(
                "the simulated rotor left the numbers: a value of the device file is far from what can be built; "
                "compare rotor and regulator with the file of 'pmsm'"
            )
        tracked = Pose(pose_stamp, pose[:3], self._still, pose[3], self._still, pose_valid)
        return Sample(t, read[:channels], read[channels:], field, tracked)

    def truth(self) -> Array:
        """(6,) mean wrench over the last `advance`: torque of coils, regulator and weight on the rotor [N·m]; neither
        hand, nor bearing, nor end stop. The bearing carries every force: the first three are zero."""
        wrench = np.zeros(6)
        wrench[3:] = self._torque
        return wrench

    def state(self) -> State:
        """The rotor as it really is."""
        R, w = np.empty((3, 3)), np.empty(3)
        matrix(self._rotor[:4], R)
        angular_velocity(self._rotor, self._joint.inertia, R, w)
        return State(self._t, R, np.zeros(3), w, np.zeros(3))

    @property
    def currents(self) -> Array:
        """(m,) the true currents [A]."""
        currents: Array = self._coils[CURRENT].copy()
        return currents

    @property
    def winding(self) -> Array:
        """(m,) the windings' true temperatures [K]."""
        winding: Array = self._coils[WINDING].copy()
        return winding

    @property
    def pressed(self) -> float:
        """How far the end stop gives way under the rotor just now [rad]; 0: it is not reached."""
        return self._pressed

    @property
    def momentum(self) -> Array:
        """(3,) angular momentum of rotor and hand, stator frame [N·m·s]."""
        momentum: Array = self.state().R_SR @ self._rotor[ANGULAR:]
        return momentum

    @property
    def energy(self) -> float:
        """Kinetic energy, and that of weight, regulator, grip and end stop [J]; zero upright at the hand's goal."""
        from haptorb.simulation.parts.hand import rotation_left

        joint, rotor = self._joint, self._rotor
        kinetic = 0.5 * float((rotor[ANGULAR:] ** 2 / joint.inertia).sum())
        left = np.empty(3)
        rotation_left(rotor[:4], self._goal, left)
        cosine = float(self.state().R_SR[2, 2])
        over = max(np.arccos(min(cosine, 1.0)) - np.arccos(joint.edge), 0.0)
        return (
            kinetic
            + 0.5 * joint.grip * float(left @ left)
            + 0.5 * joint.stop * float(over) ** 2
            + potential_energy(joint, cosine)
        )
