"""A spherical electromagnet, its tool and a hand, simulated: what the driver of a real one would meet.

The truth is finer than the controller's model: the tool's magnet has its true size (erratum E16), the core pulls it
with currents off (erratum E18), eddy currents delay the core and some of its moment stays, coils have inductance and
warm up, the moving tool induces a voltage in them, sensors are noisy, off their places and askew. So what is asked and
what is given differ here as they would in reality.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.sensor_errors import draw_sensors
from haptorb.devices.state import State
from haptorb.errors import DriverError, InputError
from haptorb.numerics.arrays import Array, Record, check_finite, vectors
from haptorb.physics.sources import dipole
from haptorb.physics.sources.charged_ring import ChargedRing
from haptorb.physics.sources.soft_sphere import SoftSphere
from haptorb.sensing.sample import Pose, Sample
from haptorb.simulation.coil_simulation import CoilSimulation
from haptorb.simulation.electromagnet.core import make_core
from haptorb.simulation.electromagnet.electromagnet_kernels import ELECTROMAGNET, advance
from haptorb.simulation.electromagnet.sensors import Magnets, pack_magnets, sense
from haptorb.simulation.electromagnet.true_heat import draw_network, fill_step
from haptorb.simulation.parts.coils import cold_coils
from haptorb.simulation.parts.hall import let_fail, make_halls
from haptorb.simulation.parts.noise import seed_noise
from haptorb.simulation.parts.tool import fill_tool, read_tool

__all__ = ["SimulatedElectromagnet"]

_ABOVE = 12e-3  #: the tool starts this far above contact [m]
_SHORTEST = 5e-6  #: a simulation with finer steps than this is slower than time [s]


@final
class SimulatedElectromagnet(CoilSimulation):
    """Coils, core, tool, dome and hand of `device`, in steps of at most `step` [s].

    specimen: number of the device among its like, from 0; the lasting errors of its sensors and its core are drawn from
    the device file's distributions with it, so that the same number is the same device for any seed of the noise.

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
        self,
        device: SphericalElectromagnet,
        seed: int = 0,
        *,
        held: bool = True,
        step: float = 2.5e-4,
        specimen: int = 0,
    ) -> None:
        if not (np.isfinite(step) and 0.0 < step <= 1e-3):
            raise InputError(f"step of the simulation must be above 0 and at most 1 ms; got {step} s")
        self.device: SphericalElectromagnet = device
        self._specimen = specimen
        super().__init__(np.zeros(1, dtype=ELECTROMAGNET), cold_coils(device), step, device.supply.duty_bits)
        self._wrench: Array = self._state["wrench"][0]
        self._state["nearest"] = device.passive_pull.nearest
        self._tool, self._senses = self._state["tool"], self._state["senses"]
        fill_tool(self._tool, device.tool, device.hand if held else None, device.contact)
        self._tool["tail"], self._tool["dome"]["radius"] = device.tool.length / 2, device.dome_radius
        supply = device.supply
        self._senses["warming"] = device.hall.warming
        self._senses["current_noise"], self._senses["current_step"] = supply.current_noise, supply.current_step
        self._senses["heat_noise"], self._senses["heat_step"] = device.thermometer_noise, device.thermometer_step
        self._longest = min(float(step), _longest_step(self._tool[0], device.name))
        tool, hall = device.tool, device.hall
        size = (tool.outer_radius, tool.inner_radius, tool.length, tool.remanence)
        self.ring = ChargedRing(*size)  #: the tool's magnet as the simulation has it
        self._rows = self.ring.rows
        self._table = np.array(device.passive_pull.table)
        self._per_ampere = np.array(device.moment_per_current, dtype=np.float64, order="C")
        nominal = np.array(hall.positions, dtype=np.float64, order="C").reshape(-1, 3)
        drawn = draw_sensors(hall.errors, len(nominal), specimen)
        self._halls = make_halls(np.tile(np.eye(3), (len(nominal), 1, 1)), drawn, hall.noise, hall.step)
        self._state["core"] = make_core(device.core_dynamics.draw(specimen))
        positions = np.ascontiguousarray(nominal + drawn.placement)
        sphere = SoftSphere(device.core_radius, device.core_permeability)
        order = 1
        if len(positions):
            closest = max(device.dome_radius - tool.length / 2, 1.1 * device.core_radius)
            order = sphere.order(closest, float(np.linalg.norm(positions, axis=1).min()), precision=1e-3)
        unit = np.stack([dipole.field(np.eye(3)[j], positions) for j in range(3)], axis=-1)  # (k, 3, 3) [T/A·m²]
        self._magnets = pack_magnets(
            Magnets(
                self._rows,
                ChargedRing(*size, radial=1, azimuth=4).rows,
                float(device.core_radius),
                sphere.response(order),
                np.ascontiguousarray(unit.reshape(-1, 3)),
                self._per_ampere,
                positions,
            )
        )
        self.reset(seed)

    def reset(self, seed: int = 0) -> None:
        """Cold coils without currents, the tool at rest 12 mm above the dome's summit, noise from `seed`."""
        self._senses["generator"] = seed_noise(seed)
        self._coils = cold_coils(self.device)
        self._heat, self._last_dt = draw_network(self.device, self._specimen), 0.0
        self._state["core_temperature"] = self.device.coils.heat.ambient
        self._state["wrench"] = self._state["depth"] = 0.0
        for name in ("lagging", "play", "extra"):
            self._state["core"][name] = 0.0
        self._t = 0.0
        self.place((0.0, 0.0, self.device.contact_distance + _ABOVE), (0.0, 0.0, 0.0, 1.0))

    def cool(self) -> None:
        """Coils at the ambient temperature at once; currents continue."""
        super().cool()
        self._state["core_temperature"] = self.device.coils.heat.ambient

    def place(self, p: ArrayLike, q: ArrayLike) -> None:
        """Put the tool at `p` (3,) [m] with quaternion `q` (4,), at rest; nearer than contact is lifted to contact.

        Raises InputError for the centre, and for what is no quaternion.
        """
        at, turned = vectors(p, "p"), check_finite(q, "q")
        if at.shape != (3,) or turned.shape != (4,) or not turned.any() or not at.any():
            raise InputError(
                f"p must be a position other than the centre, shape (3,), q a quaternion, shape (4,); got {p!r}, {q!r}"
            )
        distance = float(np.linalg.norm(at))
        tool = self._tool
        tool["p"] = at * max(1.0, self.device.contact_distance / distance)
        tool["q"] = turned / np.linalg.norm(turned)
        tool["v"] = tool["w"] = 0.0
        tool["goal"], tool["goal_q"] = at, tool["q"]

    def fail(self, sensors: Iterable[int], kind: str = "dead") -> None:
        """Let field sensors of these numbers, from 0, fail: "dead", "stuck", "saturated" or "none" (`let_fail`)."""
        let_fail(self._halls, sensors, kind)

    def _fill_heat(self, dt: float) -> None:
        fill_step(self._heat, dt, self._state["heat"][0])

    def advance(self, dt: float, duties: Array, goal_p: Array, goal_q: Array) -> None:
        """Let `dt` [s] pass; a goal that is not finite leaves the hand's last one.

        Raises InputError for less than 0 or more than 10 s.
        """
        if self._set_steps(dt):
            advance(self._state, self._coils, duties, goal_p, goal_q, self._rows, self._table, self._per_ampere)
            self._t += dt

    def sample(self, t: float, pose_stamp: float, pose_valid: bool) -> Sample:
        """One reading of every sensor, and the tool's true pose as the tracker's word.

        Raises DriverError where the simulation has left the numbers.
        """
        channels, places = self.device.channels, self.device.sensors
        read, pose = np.empty(2 * channels), np.empty((6, 3))
        field = np.empty((places, 3))
        if not sense(self._state, self._coils, self._halls, self._magnets, pose, read, field):
            raise DriverError(
                "the simulated tool's state is not finite: a value of the device file is unrealistic; "
                "compare tool, hand and contact with the file of 'omni'"
            )
        tracked = Pose(pose_stamp, pose[:3], pose[3], pose[5], pose[4], pose_valid)
        return Sample(t, read[:channels], read[channels:], field, tracked)

    def truth(self) -> Array:
        """(6,) mean wrench of coils and core on the tool over the last `advance` [N, N·m about the magnet]."""
        return self._wrench.copy()

    def state(self) -> State:
        """The tool as it really is."""
        return read_tool(self._tool, self._t)

    @property
    def boundary(self) -> Array:
        """(m,) the coil bodies' true temperatures [K]."""
        boundary: Array = self._coils["body"].copy()
        return boundary

    @property
    def core(self) -> float:
        """The true temperature of what lies between the coils [K]."""
        return float(self._state["core_temperature"][0])

    @property
    def depth(self) -> float:
        """How far the dome gives way under the tool just now [m]; 0: no contact."""
        return float(self._state["depth"][0])

    @property
    def energy(self) -> float:
        """Kinetic energy of the tool, with the hand's mass that moves along [J]."""
        state, tool = self.state(), self._tool[0]
        w = state.R_SR.T @ state.w
        return float(0.5 * tool["mass"] * (state.v @ state.v) + 0.5 * (tool["inertia"] @ w**2))


def _longest_step(tool: Record, name: str) -> float:
    """The step [s] that still follows a TOOL on the dome's spring: half a radian of its fastest oscillation."""
    stiffness, arm = float(tool["dome"]["stiffness"]), max(tool["tip"], tool["tail"])
    yielding = float(1 / tool["mass"] + arm * arm / min(tool["inertia"][:2]))
    longest = 0.5 / (stiffness * yielding) ** 0.5 if stiffness > 0.0 else 1.0
    if longest < _SHORTEST:
        raise InputError(
            f"device '{name}': a dome of {stiffness:.3g} N/m under such a light tool needs steps of "
            f"{longest * 1e6:.2g} µs, below {_SHORTEST * 1e6:.0f} µs; soften the dome or make the tool heavier"
        )
    return longest
