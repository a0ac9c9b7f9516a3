"""A spherical electromagnet, its tool and a hand, simulated: what the driver of a real one would meet.

The truth is finer than the controller's model: the tool's magnet has its true size (erratum E16), the core pulls it
with currents off (erratum E18), coils have inductance and warm up, the moving tool induces a voltage in them, sensors
are noisy. So what is asked and what is given differ here as they would in reality.
"""

from __future__ import annotations

from math import ceil
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.state import State
from haptorb.errors import DriverError, InputError
from haptorb.numerics.arrays import Array, finite, vectors
from haptorb.physics.sources import dipole
from haptorb.physics.sources.charged_ring import ChargedRing
from haptorb.physics.sources.soft_sphere import SoftSphere
from haptorb.physics.thermal import TwoNode
from haptorb.sensing.sample import Pose, Sample
from haptorb.simulation.electromagnet.electromagnet_kernels import advance
from haptorb.simulation.electromagnet.sensors import Magnets, SensorNoise, sense
from haptorb.simulation.parts.coils import BODY, CURRENT, WINDING, chop, cold, wires
from haptorb.simulation.parts.hand import LETTING_GO, Grip
from haptorb.simulation.parts.noise import seed_noise
from haptorb.simulation.parts.tool import GRAVITY, Body, DomeSurface, matrix
from haptorb.simulation.simulation import Simulation

__all__ = ["SimulatedElectromagnet"]

_ABOVE = 12e-3  #: the tool starts this far above contact [m]
_SHORTEST = 5e-6  #: a simulation with finer steps than this is slower than time [s]


@final
class SimulatedElectromagnet(Simulation):
    """Coils, core, tool, dome and hand of `device`, in steps of at most `step` [s].

    held=False lets the tool go: no hand, and gravity acts on it. With a hand, the hand carries the tool's weight.

    Raises InputError for a step above 1 ms.

    >>> from haptorb.devices.loader import load
    >>> omni = SimulatedElectromagnet(load("omni"), seed=1)
    >>> omni.place((0, 0, 0.06), (0, 0, 0, 1))
    >>> for _ in range(20):
    ...     omni.advance(1e-3, np.zeros(3), np.array([0, 0, 0.06]), np.array([0, 0, 0, 1.0]))
    >>> bool(-13e-3 < omni.truth()[2] < -11.5e-3)      # currents off, and still the core pulls, erratum E18
    True
    """

    def __init__(
        self, device: SphericalElectromagnet, seed: int = 0, *, held: bool = True, step: float = 2.5e-4
    ) -> None:
        if not (np.isfinite(step) and 0.0 < step <= 1e-3):
            raise InputError(f"step of the simulation must be above 0 and at most 1 ms; got {step} s")
        self.device: SphericalElectromagnet = device
        tool, hand, dome, hall = device.tool, device.hand, device.contact, device.hall
        self._body = Body(
            mass=float(tool.mass + (hand.mass if held else 0.0)),
            weight=0.0 if held else float(tool.mass * GRAVITY),
            inertia_x=float(tool.inertia[0]),
            inertia_y=float(tool.inertia[1]),
            inertia_z=float(tool.inertia[2]),
            tip=float(tool.tip_distance),
            tail=float(tool.length / 2),
        )
        self._dome = DomeSurface(
            float(device.dome_radius), float(dome.stiffness), float(dome.damping), float(dome.friction)
        )
        self._longest = min(float(step), _longest_step(self._body, self._dome, device.name))
        self._grip = LETTING_GO
        if held:
            self._grip = Grip(
                float(hand.stiffness), float(hand.damping), float(hand.turn_stiffness), float(hand.turn_damping)
            )
        self._wires = wires(device)
        heat = device.coils.heat
        self._heat = TwoNode(heat.winding_capacity, heat.body_capacity, heat.winding_to_body, heat.body_to_air)
        self._last_dt, self._steps, self._heat_step = 0.0, 1, np.zeros((2, 3))
        size = (tool.outer_radius, tool.inner_radius, tool.length, tool.remanence)
        self.ring = ChargedRing(*size)  #: the tool's magnet as the simulation has it
        self._rows = self.ring.rows
        self._table = np.array(device.passive_pull.table)
        self._numbers = np.array(
            [*self._wires[2:], *self._body, *self._dome, *self._grip, device.passive_pull.nearest], dtype=np.float64
        )
        self._per_ampere = np.array(device.moment_per_current, dtype=np.float64, order="C")
        positions = np.array(hall.positions, dtype=np.float64, order="C").reshape(-1, 3)
        self._positions = positions
        supply = device.supply
        senses = SensorNoise(
            float(hall.noise),
            float(hall.step),
            float(supply.current_noise),
            float(supply.current_step),
            float(device.thermometer_noise),
            float(device.thermometer_step),
        )
        sphere = SoftSphere(device.core_radius, device.core_permeability)
        order = 1
        if len(positions):
            closest = max(device.dome_radius - tool.length / 2, 1.1 * device.core_radius)
            order = sphere.order(closest, float(np.linalg.norm(positions, axis=1).min()), precision=1e-3)
        unit = np.stack([dipole.field(np.eye(3)[j], positions) for j in range(3)], axis=-1)  # (k, 3, 3) [T/A·m²]
        self._sensing = np.array([*senses, device.core_radius])
        self._magnets = Magnets(
            self._rows,
            ChargedRing(*size, radial=1, azimuth=4).rows,
            float(device.core_radius),
            sphere.response(order),
            np.ascontiguousarray((unit @ self._per_ampere).reshape(3 * len(positions), -1)),
        )
        self._steps_of_duty = float(2**device.supply.duty_bits)
        self._truth = np.zeros(6)
        self._goal = np.zeros(7)  # position and quaternion to which the hand pulls
        self.reset(seed)

    def reset(self, seed: int = 0) -> None:
        """Cold coils without currents, the tool at rest 12 mm above the dome's summit, noise from `seed`."""
        self._noise = seed_noise(seed)
        self._coils = cold(self._wires)
        self._tool = np.zeros(13)
        self._truth[:] = 0.0
        self._t = 0.0
        self._depth = 0.0
        self.place((0.0, 0.0, self.device.contact_distance + _ABOVE), (0.0, 0.0, 0.0, 1.0))

    def place(self, p: ArrayLike, q: ArrayLike) -> None:
        """Put the tool at `p` (3,) [m] with quaternion `q` (4,), at rest; nearer than contact is lifted to contact.

        Raises InputError for the centre, and for what is no quaternion.
        """
        at, turned = vectors(p, "p"), finite(q, "q")
        if at.shape != (3,) or turned.shape != (4,) or not turned.any() or not at.any():
            raise InputError(
                f"p must be a place off the centre, shape (3,), q a quaternion, shape (4,); got {p!r}, {q!r}"
            )
        distance = float(np.linalg.norm(at))
        self._tool[:3] = at * max(1.0, self.device.contact_distance / distance)
        self._tool[3:7] = turned / np.linalg.norm(turned)
        self._tool[7:] = 0.0
        self._goal[:3], self._goal[3:] = at, self._tool[3:7]

    def quantise(self, duties: Array) -> Array:
        """(m,) what the chopper makes of `duties` (m,): clipped to −1…1, in its steps; not a number: zero."""
        out = np.empty(self.device.channels)
        chop(np.ascontiguousarray(duties, dtype=np.float64), self._steps_of_duty, out)
        return out

    def advance(self, dt: float, duties: Array, goal_p: Array, goal_q: Array) -> None:
        """Let `dt` [s] pass; a goal that is not finite leaves the hand's last one.

        Raises InputError for less than 0 or more than 10 s.
        """
        if not (0.0 <= dt < 10.0):
            raise InputError(f"the simulation can advance by 0 to 10 s at once; got {dt} s")
        if dt == 0.0:
            return
        if dt != self._last_dt:
            steps = max(ceil(dt / self._longest - 1e-9), 1)
            self._last_dt, self._steps, self._heat_step = dt, steps, self._heat.step(dt / steps)
        wires = self._wires
        self._depth = advance(
            self._tool, self._coils, duties, goal_p, goal_q, self._goal, self._numbers, wires.resistance,
            wires.inductance, self._heat_step, self._rows, self._table, self._per_ampere, dt / self._steps,
            self._steps, self._truth,
        )  # fmt: skip
        self._t += dt

    def sample(self, t: float, pose_stamp: float, pose_valid: bool) -> Sample:
        """One reading of every sensor, and the tool's true pose as the tracker's word.

        Raises DriverError where the simulation has left the numbers.
        """
        channels, places = self.device.channels, len(self._positions)
        magnets = self._magnets
        read, pose = np.empty(2 * channels), np.empty((6, 3))
        field = np.empty((places, 3))
        if not sense(
            self._tool, self._coils, self._positions, magnets.ring, magnets.coarse, magnets.response,
            magnets.per_ampere, self._sensing, self._noise, pose, read, field,
        ):  # fmt: skip
            raise DriverError(
                "the simulated tool left the numbers: a value of the device file is far from what can be built; "
                "compare tool, hand and contact with the file of 'omni'"
            )
        tracked = Pose(pose_stamp, pose[:3], pose[3], pose[5], pose[4], pose_valid)
        return Sample(t, read[:channels], read[channels:], field, tracked)

    def truth(self) -> Array:
        """(6,) mean wrench of coils and core on the tool over the last `advance` [N, N·m about the magnet]."""
        return self._truth.copy()

    def state(self) -> State:
        """The tool as it really is."""
        R = np.empty((3, 3))
        tool = self._tool.copy()
        matrix(tool[3:7], R)
        return State(self._t, R, tool[:3], tool[10:], tool[7:10])

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
    def boundary(self) -> Array:
        """(m,) the coil bodies' true temperatures [K]."""
        boundary: Array = self._coils[BODY].copy()
        return boundary

    @property
    def depth(self) -> float:
        """How far the dome gives way under the tool just now [m]; 0: no contact."""
        return self._depth

    @property
    def energy(self) -> float:
        """Kinetic energy of the tool, with the hand's mass that moves along [J]."""
        body, tool = self._body, self._tool
        w = self.state().R_SR.T @ tool[10:]
        inertia = np.array([body.inertia_x, body.inertia_y, body.inertia_z])
        return float(0.5 * body.mass * (tool[7:10] @ tool[7:10]) + 0.5 * (inertia @ w**2))


def _longest_step(body: Body, dome: DomeSurface, name: str) -> float:
    """The step [s] that still follows the tool on the dome's spring: half a radian of its fastest oscillation."""
    arm = max(body.tip, body.tail)
    yielding = 1 / body.mass + arm * arm / min(body.inertia_x, body.inertia_y)
    longest = 0.5 / (dome.stiffness * yielding) ** 0.5 if dome.stiffness > 0.0 else 1.0
    if longest < _SHORTEST:
        raise InputError(
            f"device '{name}': a dome of {dome.stiffness:.3g} N/m under so light a tool wants steps of "
            f"{longest * 1e6:.2g} µs, below {_SHORTEST * 1e6:.0f} µs; soften the dome or make the tool heavier"
        )
    return longest
