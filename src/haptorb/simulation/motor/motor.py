"""A spherical motor and a hand on its handle, simulated: what the driver of a real one would meet.

The coils have inductance, warm up, and feel the turning magnets as an electromotive force from the same torque
characteristic that turns currents into torque; weight and regulator act on the rotor; the bearing rubs and the rotor
stops at the edge of its workspace; 48 imperfect Hall sensors see the magnets and the coils. Not modelled: eddy currents
(all parts but the magnets are non-magnetic, and the frame is taken as non-conducting), mutual inductance of the coils,
the chopper's ripple, and the bearing's clearance.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.devices.motor.handle import Grasp
from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.devices.sensor_errors import SensorErrors, draw_sensors
from haptorb.devices.state import State
from haptorb.errors import DriverError, InputError
from haptorb.numerics.arrays import Array, check_finite
from haptorb.sensing.sample import Pose, Sample
from haptorb.simulation.coil_simulation import CoilSimulation
from haptorb.simulation.motor.hanging import limit_tilt, make_rotor_record, potential_energy
from haptorb.simulation.motor.motor_kernels import MOTOR, Magnetics, advance, pack_magnetics, sense
from haptorb.simulation.motor.rotor import angular_velocity
from haptorb.simulation.parts.coils import cold_coils
from haptorb.simulation.parts.hall import let_fail, make_halls
from haptorb.simulation.parts.hand import fill_remaining_rotation
from haptorb.simulation.parts.noise import seed_noise
from haptorb.simulation.parts.tool import matrix

__all__ = ["SimulatedMotor"]


@final
class SimulatedMotor(CoilSimulation):
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
        tables, supply = device.tables, device.supply
        super().__init__(np.zeros(1, dtype=MOTOR), cold_coils(device), float(step), supply.duty_bits)
        self._still = np.zeros(3)
        self._state["current_noise"], self._state["current_step"] = supply.current_noise, supply.current_step
        self._state["warming"] = device.hall.warming
        self._state["heat_noise"], self._state["heat_step"] = device.thermometer_noise, device.thermometer_step
        self._state["rotor"] = make_rotor_record(device, self.grasp)
        self._rotor, self._torque = self._state["rotor"], self._state["torque"][0]
        self._parts = Magnetics(
            tables.torque_pair.cells,
            float(tables.torque_pair.scale),
            tables.field_pair.cells,
            float(tables.field_pair.scale),
            device.magnets.directions,
            device.electromagnets.directions,
            device.sensor_layout.directions,
            device.groups,
            device.sensor_field_per_ampere,
            device.tilt_torque[0],
        )
        self._magnetics = pack_magnetics(self._parts)
        self._failures = np.zeros(device.sensors, dtype=np.int64)
        self.reset(seed)

    def reset(self, seed: int = 0) -> None:
        """Cold coils without currents, the rotor upright and at rest, noise and lasting errors from `seed`."""
        self._state["generator"] = seed_noise(seed)
        device, hall = self.device, self.device.hall
        specimen = draw_sensors(self._quality, device.sensors, seed)
        self._halls = make_halls(device.sensor_layout.frames, specimen, hall.noise, hall.step)
        self._halls["failure"] = self._failures
        draw = np.random.Generator(np.random.PCG64([seed, 1]))
        polarity = np.array(device.polarity, dtype=np.float64)
        self._strength = polarity * (1.0 + self._spread * draw.standard_normal(len(polarity)))
        self._coils = cold_coils(device)
        self._rotor["q"] = self._rotor["goal"] = (0.0, 0.0, 0.0, 1.0)
        self._rotor["momentum"] = self._state["torque"] = self._state["pressed"] = 0.0
        self._t = 0.0

    def place(self, p: ArrayLike, q: ArrayLike) -> None:
        """Turn the rotor to `q` (4,), at rest; beyond the edge it is set onto the edge. `p` (3,) means nothing here.

        Raises InputError for what is no quaternion.
        """
        turned = check_finite(q, "q")
        if turned.shape != (4,) or not turned.any():
            raise InputError(f"q must be a quaternion (x, y, z, w) that is not zero; got {q!r}")
        self._rotor["q"] = limit_tilt(turned / np.linalg.norm(turned), self.device.workspace_tilt)
        self._rotor["momentum"] = 0.0
        self._rotor["goal"] = turned / np.linalg.norm(turned)

    def spin(self, w: ArrayLike) -> None:
        """Give the rotor the angular velocity `w` (3,) [rad/s], stator frame. Raises InputError for another shape."""
        rate = check_finite(w, "w")
        if rate.shape != (3,):
            raise InputError(f"w must have shape (3,); got {rate.shape}")
        self._rotor["momentum"] = self._rotor["inertia"] * (self.state().R_SR.T @ rate)

    def fail(self, sensors: Iterable[int], kind: str = "dead") -> None:
        """Let field sensors of these numbers, from 0, fail: "dead", "stuck", "saturated" or "none" (`let_fail`).

        A reset does not repair them.
        """
        let_fail(self._halls, sensors, kind)
        self._failures[:] = self._halls["failure"]

    def _fill_heat(self, dt: float) -> None:
        self._state["heat"] = self.device.coils.heat.coil.step(dt)

    def advance(self, dt: float, duties: Array, goal_p: Array, goal_q: Array) -> None:
        """Let `dt` [s] pass; a goal that is not finite leaves the hand's last one, and `goal_p` means nothing here.

        Raises InputError for less than 0 or more than 10 s.
        """
        if self._set_steps(dt):
            advance(self._state, self._coils, self._magnetics, self._strength, duties, goal_q)
            self._t += dt

    def sample(self, t: float, pose_stamp: float, pose_valid: bool) -> Sample:
        """One reading of every sensor; the pose is the true one, as an external tracker would tell it.

        Raises DriverError where the simulation has left the numbers.
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

    def truth(self) -> Array:
        """(6,) mean wrench over the last `advance`: torque of coils, regulator and weight on the rotor [N·m]; neither
        hand, nor bearing, nor end stop. The bearing carries every force: the first three are zero."""
        wrench = np.zeros(6)
        wrench[3:] = self._torque
        return wrench

    def state(self) -> State:
        """The rotor as it really is."""
        R, w = np.empty((3, 3)), np.empty(3)
        rotor = self._rotor
        matrix(rotor["q"][0], R)
        angular_velocity(rotor["momentum"][0], rotor["inertia"][0], R, w)
        return State(self._t, R, np.zeros(3), w, np.zeros(3))

    @property
    def stop_deflection(self) -> float:
        """How far the end stop gives way under the rotor just now [rad]; 0: it is not reached."""
        return float(self._state["pressed"][0])

    @property
    def momentum(self) -> Array:
        """(3,) angular momentum of rotor and hand, stator frame [N·m·s]."""
        momentum: Array = self.state().R_SR @ self._rotor["momentum"][0]
        return momentum

    @property
    def energy(self) -> float:
        """Kinetic energy, and that of weight, regulator, grip and end stop [J]; zero upright at the hand's goal."""
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
