"""Simulation of a spherical electromagnet with its tool and a hand, behind the driver interface.

The plant differs from the controller's model: coils, core and magnet are those of one specimen
(`electromagnet_specimen`); the core has eddy currents, remanence and saturation; coils have inductance and warm up; the
moving tool induces a voltage in them; sensors are noisy, displaced and misaligned. So commanded and actual wrench
differ as on a real device.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple, final
from zlib import crc32

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, Record, Records, check_finite, fields, vectors
from haptorb.compiled import kernel, pack, part
from haptorb.devices.base import Device, State
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.field_sensors import draw_sensors
from haptorb.errors import DriverError, InputError
from haptorb.estimation.types import Pose, Sample
from haptorb.magnetics.dipole import point_field
from haptorb.magnetics.magnets import ChargedRing, charge_field
from haptorb.magnetics.soft_sphere import add_induced_field
from haptorb.simulation.base import CoilSimulation
from haptorb.simulation.coil_circuits import cold_coils, network_coil_step
from haptorb.simulation.electromagnet_specimen import (
    ElectromagnetSpecimen,
    Steel,
    draw_electromagnet,
    fill_truth,
)
from haptorb.simulation.hall_sensors import let_fail, make_halls, quantise, read_halls
from haptorb.simulation.magnetic_core import CORE, core_step, make_core
from haptorb.simulation.noise_generator import fill_normal, seed_noise
from haptorb.simulation.surface_contact import contact
from haptorb.simulation.tool_dynamics import (
    TOOL,
    fill_remaining_rotation,
    fill_tool,
    matrix,
    move,
    read_tool,
    set_goal,
)
from haptorb.simulation.wrench_map_extrapolation import find_share, is_elsewhere
from haptorb.thermal import ThermalNetwork

__all__ = [
    "COILS",
    "ELECTROMAGNET",
    "NODES",
    "SENSES",
    "Magnets",
    "SimulatedElectromagnet",
    "advance",
    "draw_network",
    "fill_step",
    "pack_magnets",
    "sense",
]


# --------------------------------------------------------------------------------------------------
# Sensor readings of a spherical electromagnet: currents, coil boundaries, and the field at nine positions.
#
# The field at a Hall sensor is that of coils and core (`coil_fields`), of the dipole of eddy currents and remanence,
# of the tool's ring as charges on its faces, and of the core's response to the ring, at the sensor's true position.
# `simulation.hall_sensors` models the sensor itself; every reading has normal noise and its converter's step.


#: Accuracy of the current and temperature sensors, standard deviation and step; generator of all noise.
SENSES = fields(
    ("warming", "f8"),  # temperature rise of the field sensors relative to that of the coils at their boundary
    ("current_noise", "f8"),  # [A]
    ("current_step", "f8"),  # [A]
    ("heat_noise", "f8"),  # [K]
    ("heat_step", "f8"),  # [K]
    ("generator", "u8", (4,)),
)


class Magnets(NamedTuple):
    """Field sources and sensor positions, relative to the core's centre."""

    ring: Array  #: (4, n) charges of the tool's magnet, mover frame [m, A·m]
    coarse: Array  #: (4, n') the same magnet with fewer charges: sufficient for the core's response
    core_radius: float  #: [m]
    response: Array  #: (L,) the core's response by degree
    per_moment: Array  #: (3 k, 3) field of a moment in the core at the sensors [T/(A·m²)]
    per_ampere: Array  #: (3 k, m) field of coils and core at the sensors [T/A]
    sensors: Array  #: (k, 3) true positions [m]
    core: Array  #: (1, 3) its centre, stator frame [m]
    stretch: Array  #: (3, 3) moment of the core per field minus that of a ball [A·m²/T]
    constant: Array  #: (k, 3) constant field at the sensors [T]
    steel: Array  #: (1, 4) position of a steel object [m], and its moment per field [A·m²/T]
    per_steel: Array  #: (3 k, 3) field of a moment there at the sensors [T/(A·m²)]


def pack_magnets(magnets: Magnets) -> Array:
    """(n,) `magnets` packed for compiled code, each number in the unit [..] of its field."""
    m = magnets
    return pack(
        (m.core_radius,), m.ring, m.coarse, m.response, m.per_moment, m.per_ampere, m.sensors, m.core, m.stretch,
        m.constant, m.steel, m.per_steel,
    )  # fmt: skip


@kernel
def _unpack_magnets(blob: Array) -> Magnets:
    return Magnets(
        part(blob, 1), part(blob, 2), part(blob, 0)[0, 0], part(blob, 3)[0], part(blob, 4), part(blob, 5),
        part(blob, 6), part(blob, 7), part(blob, 8), part(blob, 9), part(blob, 10), part(blob, 11),
    )  # fmt: skip


@kernel
def _place_charges(rows: Array, R: Array, p: Array, out: Array) -> None:
    for n in range(rows.shape[1]):
        for i in range(3):
            out[i, n] = p[i] + R[i, 0] * rows[0, n] + R[i, 1] * rows[1, n] + R[i, 2] * rows[2, n]
        out[3, n] = rows[3, n]


@kernel
def _fill_field(magnets: Magnets, coils: Records, extra: Array, R: Array, p: Array, out: Array) -> None:
    """out (k, 3) [T]: the field at the sensors with the coils' currents and the tool at R (3, 3), p (3,).

    extra (3,) [A·m²]: the electromagnet's moment in addition to that of its currents.
    """
    ring, coarse, sensors = np.empty_like(magnets.ring), np.empty_like(magnets.coarse), magnets.sensors
    away, at_core, at_steel, more, steel = np.empty(3), np.zeros(3), np.zeros(3), np.empty(3), np.zeros(3)
    for i in range(3):
        away[i] = p[i] - magnets.core[0, i]
    _place_charges(magnets.ring, R, away, ring)
    _place_charges(magnets.coarse, R, away, coarse)
    charge_field(coarse, 0.0, 0.0, 0.0, at_core)
    if magnets.steel[0, 3] > 0.0:
        for i in range(3):
            steel[i] = magnets.steel[0, i] - magnets.core[0, i]
        charge_field(coarse, steel[0], steel[1], steel[2], at_steel)
    for i in range(3):
        more[i], steel[i] = extra[i], magnets.steel[0, 3] * at_steel[i]
        for a in range(3):
            more[i] += magnets.stretch[i, a] * at_core[a]
    for k in range(sensors.shape[0]):
        for i in range(3):
            total = magnets.constant[k, i]
            for a in range(3):
                total += magnets.per_moment[3 * k + i, a] * more[a] + magnets.per_steel[3 * k + i, a] * steel[a]
            for j in range(coils.size):
                total += magnets.per_ampere[3 * k + i, j] * coils[j].current
            out[k, i] = total
        x, y, z = sensors[k, 0], sensors[k, 1], sensors[k, 2]
        charge_field(ring, x, y, z, out[k])
        add_induced_field(coarse, magnets.core_radius, magnets.response, x, y, z, out[k])


@kernel
def _is_finite(tool: Record) -> bool:
    """Whether pose and motion of a TOOL are finite."""
    total = tool.q[3]
    for i in range(3):
        total += tool.p[i] + tool.q[i] + tool.v[i] + tool.w[i]
    return bool(np.isfinite(total))


@kernel
def sense(
    electromagnet: Records, coils: Records, halls: Records, magnets: Array, pose: Array, read: Array, field: Array
) -> bool:
    """Read each sensor once, and the tool's true pose; False, without a reading, if the tool's state is not finite.

    electromagnet (1,) ELECTROMAGNET, coils (m,) COIL, halls (k,) HALL, magnets as `pack_magnets` made them; pose (6, 3)
    becomes R, p, v and w; read (2 m,) currents [A], then temperatures [K]; field (k, 3) [T].
    """
    tool, s = electromagnet[0].tool, electromagnet[0].senses
    if not _is_finite(tool):
        return False
    matrix(tool.q[:], pose[:3])
    for i in range(3):
        pose[3, i], pose[4, i], pose[5, i] = tool.p[i], tool.v[i], tool.w[i]
    count = coils.size
    draws = np.empty(2 * count)
    fill_normal(s.generator, draws)
    _fill_field(_unpack_magnets(magnets), coils, electromagnet[0].core.extra, pose[:3], pose[3], field)
    warmth = 0.0
    for k in range(count):
        read[k] = quantise(coils[k].current + s.current_noise * draws[k], s.current_step)
        read[count + k] = quantise(coils[k].body + s.heat_noise * draws[count + k], s.heat_step)
        warmth += s.warming * (coils[k].body - coils[k].ambient) / count
    read_halls(halls, s.generator, warmth, field)
    return True


# --------------------------------------------------------------------------------------------------
# Thermal network of the simulated coils: values differ from those of the device file and the controller.
#
# Every capacity and conductance has its own error within the file's tolerance, and a small heat flow leaves the core
# through the stand, which the file's network does not model.


COILS = 3
NODES = 2 * COILS + 1  #: windings, bodies, and a core, which uncoupled coils do not warm
_STAND_CONDUCTANCE = 0.05  #: conductance of the stand, relative to that of all bodies to the air


def draw_network(device: Device, specimen: int = 0) -> ThermalNetwork:
    """Network of a `specimen` of `device` within its tolerances; the file's own if its values are exact.

    Reproducible for one file and number.
    """
    heat = device.coils.heat
    network = heat.network(device.channels)
    draw = np.random.Generator(np.random.PCG64([crc32(device.digest.encode()), specimen]))

    def spread(values: Array) -> Array:
        spread_values: Array = values * (1.0 + heat.tolerance * draw.uniform(-1.0, 1.0, values.shape))
        return spread_values

    between = np.triu(spread(network.exchange))
    to_air = spread(network.to_air)
    if heat.coupling is not None:
        to_air[-1] = _STAND_CONDUCTANCE * to_air.sum()
    return replace(network, capacity=spread(network.capacity), exchange=between + between.T, to_air=to_air)


def fill_step(network: ThermalNetwork, dt: float, out: Array) -> None:
    """`out` (7, 10) becomes the network's step over `dt` [s]; without a core its temperature is constant."""
    step, n = network.step(dt), network.nodes
    out[:] = 0.0
    out[-1, NODES - 1] = 1.0
    out[:n, :n], out[:n, NODES:] = step[:, :n], step[:, n:]


# --------------------------------------------------------------------------------------------------
# Physics of an electromagnet in compiled code: steps of coils, core, tool, dome and hand.


_MIN_MAP_STEPS = 4  #: minimum number of steps between two maps

#: State and settings of a simulated electromagnet except its coils and its map.
ELECTROMAGNET = fields(
    ("tool", TOOL),
    ("senses", SENSES),
    ("dt", "f8"),  # of a step [s]
    ("steps", "i8"),  # in one call
    ("heat", "f8", (NODES, NODES + COILS)),  # `ThermalNetwork.step` of a step
    ("core_temperature", "f8"),  # temperature of the core between the coils [K]
    ("core", CORE),
    ("wrench", "f8", (6,)),  # of coils and core on the tool, mean of the last call [N, N·m]
    ("depth", "f8"),  # deflection of the dome under the tool [m]
    ("age", "i8"),  # of the newest map [steps]
)
#: Rows of a stored map: R (3) and p, passive, per current (6), per moment in the core (6).
_HELD = 17


@kernel
def _is_map_old(electromagnet: Records, held: Array, pose: Array) -> bool:
    """Whether a new map is needed at `pose` (4, 3), which becomes R above p: the newest of `held` is old, and the tool
    has moved."""
    e = electromagnet[0]
    matrix(e.tool.q[:], pose[:3])
    for i in range(3):
        pose[3, i] = e.tool.p[i]
    return bool(e.age >= _MIN_MAP_STEPS and is_elsewhere(held[0], pose[:3], e.tool.p))


@kernel
def advance(
    electromagnet: Records, coils: Records, duties: Array, goal_p: Array, goal_q: Array, moment_per_current: Array,
    held: Array, first: int, steps: int,
) -> None:  # fmt: skip
    """Advance `electromagnet` (1,) ELECTROMAGNET and `coils` (m,) COIL by several steps of the whole simulation.

    steps: of the call's, after the `first` of them.

    duties (m,); the hand moves to goal_p (3,) [m] and goal_q (4,) if they are valid, else to its last goal;
    moment_per_current (6, m) [m²] as in `core_step`; held (2, 17, 6): the newest map, and its change since the previous
    one.
    """
    e = electromagnet[0]
    tool, wrench, dt, count = e.tool, e.wrench, e.dt, coils.size
    set_goal(tool, goal_p, goal_q)
    R, turn = np.empty((3, 3)), np.empty(3)
    per_moment, per_current = np.empty((6, 3)), np.empty((6, count))
    given, total = np.empty(6), np.empty(6)
    newest, change = held[0], held[1]
    for k in range(count):
        coils[k].duty = duties[k]
    if first == 0:
        wrench[:] = 0.0
    for _ in range(steps):
        matrix(tool.q[:], R)
        e.age += 1
        share = find_share(newest, change, R, tool.p)
        for i in range(6):
            given[i] = newest[4, i] + share * change[4, i]
            for k in range(count):
                per_current[i, k] = newest[5 + i, k] + share * change[5 + i, k]
            for k in range(3):
                per_moment[i, k] = newest[11 + i, k] + share * change[11 + i, k]
        for k in range(count):  # the power that leaves the coil's circuit equals the power delivered to the tool
            emf = 0.0
            for i in range(3):
                emf += per_current[i, k] * tool.v[i]
            for i in range(3):
                emf += per_current[3 + i, k] * tool.w[i]
            coils[k].emf = emf
        e.core_temperature = network_coil_step(coils, e.heat, e.core_temperature, dt)
        core_step(e.core, moment_per_current, coils, dt)
        for i in range(6):
            for k in range(count):
                given[i] += per_current[i, k] * coils[k].mean
            for k in range(3):
                given[i] += per_moment[i, k] * e.core.extra[k]
            wrench[i] += given[i] / e.steps
            total[i] = given[i]
        e.depth = contact(tool, R, dt, total)
        fill_remaining_rotation(tool.q, tool.goal_q, turn)
        move(tool, R, turn, total, dt)


_INITIAL_MAP_AGE = 1_000_000  #: initial age, so that the map is computed at the first step [steps]
_INITIAL_HEIGHT_M = 12e-3  #: initial height of the tool above contact [m]
_MIN_STEP_S = 5e-6  #: minimum step: with finer ones a simulation is slower than real time [s]


@final
class SimulatedElectromagnet(CoilSimulation):
    """Simulation of coils, core, tool, dome and hand of `device`, in steps of at most `step` [s].

    specimen: number of the specimen, from 0: seed of its coils, core, magnet and sensors, drawn from the device file's
    distributions, independent of the seed of the noise. None: `seed`. steel: an object nearby.

    held=False: no hand, and gravity acts on the tool. With a hand, the hand carries the tool's weight.

    Raises InputError for a step above 1 ms.

    >>> from haptorb.devices.loader import load
    >>> omni = SimulatedElectromagnet(replace(load("omni"), tolerance=None))      # as its file says
    >>> omni.place((0, 0, 0.06), (0, 0, 0, 1))
    >>> for _ in range(20):
    ...     omni.advance(1e-3, np.zeros(3), np.array([0, 0, 0.06]), np.array([0, 0, 0, 1.0]))
    >>> bool(-12.3e-3 < omni.wrench_actual()[2] < -12.2e-3)      # currents off: the core attracts the tool, erratum E18
    True
    """

    def __init__(
        self,
        device: SphericalElectromagnet,
        seed: int = 0,
        *,
        held: bool = True,
        step: float = 2.5e-4,
        specimen: int | None = None,
        steel: Steel | None = None,
    ) -> None:
        if not (np.isfinite(step) and 0.0 < step <= 1e-3):
            raise InputError(f"step of the simulation must be above 0 and at most 1 ms; got {step} s")
        self.device: SphericalElectromagnet = device
        self._specimen = specimen = seed if specimen is None else specimen
        seed_noise(specimen)  # rejects an invalid specimen number
        super().__init__(np.zeros(1, dtype=ELECTROMAGNET), cold_coils(device), step, device.supply.duty_bits)
        self._wrench: Array = self._state["wrench"][0]
        self._tool, self._senses = self._state["tool"], self._state["senses"]
        fill_tool(self._tool, device.tool, device.hand if held else None, device.contact)
        self._tool["tail"], self._tool["dome"]["radius"] = device.tool.length / 2, device.dome_radius
        supply = device.supply
        self._senses["warming"] = device.hall.warming
        self._senses["current_noise"], self._senses["current_step"] = supply.current_noise, supply.current_step
        self._senses["heat_noise"], self._senses["heat_step"] = device.thermometer_noise, device.thermometer_step
        self._longest = min(float(step), _longest_step(self._tool[0], device.name))
        tool, hall = device.tool, device.hall
        built = draw_electromagnet(device, specimen, steel)
        self.built: ElectromagnetSpecimen = built  #: the true device, which the controller's model approximates
        self.ring = built.ring  #: the tool's magnet in the simulation
        closest = max(device.dome_radius - tool.length / 2, 1.1 * built.core.radius)
        self._truth = built.compute_map(device.dome_radius)
        self._per_ampere = np.vstack([built.compute_moments(), built.compute_core_moments()])
        self._pose, self._map = np.empty((4, 3)), (np.empty((6, device.channels)), np.empty(6), np.empty((6, 3)))
        nominal = np.array(hall.positions, dtype=np.float64, order="C").reshape(-1, 3)
        drawn = draw_sensors(hall.errors, len(nominal), specimen)
        self._halls = make_halls(np.tile(np.eye(3), (len(nominal), 1, 1)), drawn, hall)
        self._state["core"] = make_core(device.core_dynamics.draw(specimen), built.core, device.core_saturation)
        positions = np.ascontiguousarray(nominal + drawn.placement)
        seen, order = positions - built.core_place, 1
        if len(positions):
            order = built.core.order(closest, float(np.linalg.norm(seen, axis=1).min()), precision=1e-3)
        unit, near = point_field(seen), np.zeros((len(positions), 3, 3))
        constant = built.earth + unit @ self._truth.earth_moment
        place = np.zeros(4)
        if steel is not None:
            place[:3], place[3] = steel.place, steel.share
            near = point_field(positions - steel.place)
            constant = constant + near @ (steel.share * built.earth)
        ring = built.ring
        self._magnets = pack_magnets(
            Magnets(
                ring.rows,
                ChargedRing(
                    ring.outer_radius, ring.inner_radius, ring.length, ring.remanence, radial=1, azimuth=4
                ).rows,
                float(built.core.radius),
                built.core.response(order),
                np.ascontiguousarray(unit.reshape(-1, 3)),
                np.ascontiguousarray(built.compute_fields(self._truth, positions).reshape(-1, device.channels)),
                seen,
                built.core_place[None],
                self._truth.stretch,
                np.ascontiguousarray(constant),
                place[None],
                np.ascontiguousarray(near.reshape(-1, 3)),
            )
        )
        self.reset(seed)

    def reset(self, seed: int = 0) -> None:
        """Reset: cold coils without currents, the tool at rest 12 mm above the dome's summit, noise from `seed`."""
        self._senses["generator"] = seed_noise(seed)
        self._coils = cold_coils(self.device)
        self._heat, self._last_dt = draw_network(self.device, self._specimen), 0.0
        self._heat_steps.clear()
        self._state["core_temperature"] = self.device.coils.heat.ambient
        self._state["wrench"] = self._state["depth"] = 0.0
        for name in ("lagging", "play", "extra"):
            self._state["core"][name] = 0.0
        self._held = np.full((2, _HELD, 6), np.nan)
        self._t = 0.0
        self.place((0.0, 0.0, self.device.contact_distance + _INITIAL_HEIGHT_M), (0.0, 0.0, 0.0, 1.0))

    def cool(self) -> None:
        """Set the coils to the ambient temperature; currents do not change."""
        super().cool()
        self._state["core_temperature"] = self.device.coils.heat.ambient

    def place(self, p: ArrayLike, q: ArrayLike) -> None:
        """Place the tool at `p` (3,) [m] with quaternion `q` (4,), at rest; below contact it is raised to contact.

        Raises InputError for the centre, and for an invalid quaternion.
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
        self._state["age"] = _INITIAL_MAP_AGE

    def fail(self, sensors: Iterable[int], kind: str = "dead") -> None:
        """Make field sensors of these numbers, from 0, fail: "dead", "stuck", "saturated" or "none" (`let_fail`)."""
        let_fail(self._halls, sensors, kind)

    def _fill_heat(self, dt: float) -> None:
        fill_step(self._heat, dt, self._state["heat"][0])

    def advance(self, dt: float, duties: Array, goal_p: Array, goal_q: Array) -> None:
        """Advance by `dt` [s]; a goal that is not finite leaves the hand's last one.

        Raises InputError for less than 0 or more than 10 s.
        """
        if self._set_steps(dt):
            whole = int(self._state["steps"][0])
            for first in range(0, whole, _MIN_MAP_STEPS):
                if _is_map_old(self._state, self._held, self._pose):
                    self._renew()
                advance(
                    self._state, self._coils, duties, goal_p, goal_q, self._per_ampere, self._held, first,
                    min(_MIN_MAP_STEPS, whole - first),
                )  # fmt: skip
            self._t += dt

    def _renew(self) -> None:
        """Compute the map at the tool's pose as the newest one."""
        newest, change = self._held
        matrix, passive, per_moment = self._map
        fill_truth(self._truth, self._pose[:3], self._pose[3], matrix, passive, per_moment)
        change[:] = -newest
        newest[:4, :3], newest[4] = self._pose, passive
        newest[5:11, : matrix.shape[1]], newest[11:, :3] = matrix, per_moment
        change += newest
        if not np.isfinite(change[3, 0]):  # the first map
            change[:] = 0.0
        self._state["age"] = 0

    def sample(self, t: float, pose_stamp: float, pose_valid: bool) -> Sample:
        """Read every sensor once, with the tool's true pose as the tracker's output.

        Raises DriverError if the simulated state is not finite.
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

    def wrench_actual(self) -> Array:
        """(6,) mean wrench of coils and core on the tool over the last `advance` [N, N·m about the magnet]."""
        return self._wrench.copy()

    def state(self) -> State:
        """True state of the tool."""
        return read_tool(self._tool, self._t)

    @property
    def boundary(self) -> Array:
        """(m,) true temperatures of the coil bodies [K]."""
        boundary: Array = self._coils["body"].copy()
        return boundary

    @property
    def core(self) -> float:
        """True temperature of the core between the coils [K]."""
        return float(self._state["core_temperature"][0])

    @property
    def depth(self) -> float:
        """Present deflection of the dome under the tool [m]; 0: no contact."""
        return float(self._state["depth"][0])

    @property
    def energy(self) -> float:
        """Kinetic energy of tool and effective hand mass [J]."""
        state, tool = self.state(), self._tool[0]
        w = state.R_SR.T @ state.w
        return float(0.5 * tool["mass"] * (state.v @ state.v) + 0.5 * (tool["inertia"] @ w**2))


def _longest_step(tool: Record, name: str) -> float:
    """Maximum step [s] for a TOOL on the dome's spring: half a radian of its fastest oscillation."""
    stiffness, arm = float(tool["dome"]["stiffness"]), max(tool["tip"], tool["tail"])
    yielding = float(1 / tool["mass"] + arm * arm / min(tool["inertia"][:2]))
    longest = 0.5 / (stiffness * yielding) ** 0.5 if stiffness > 0.0 else 1.0
    if longest < _MIN_STEP_S:
        raise InputError(
            f"device '{name}': a dome of {stiffness:.3g} N/m under such a light tool needs steps of "
            f"{longest * 1e6:.2g} µs, below {_MIN_STEP_S * 1e6:.0f} µs; soften the dome or make the tool heavier"
        )
    return longest
