"""A spherical electromagnet, its tool and a hand, simulated: what the driver of a real one would meet.

The truth is finer than the controller's model: coils and the tool's magnet have their true size (erratum E16), the core
pulls the magnet with currents off (erratum E18), eddy currents delay the core and some of its moment stays, coils have
inductance and warm up, the moving tool induces a voltage in them, sensors are noisy, off their places and askew. So
what is asked and what is given differ here as they would in reality.
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
from haptorb.devices.electromagnet import SphericalElectromagnet, point_field
from haptorb.devices.electromagnet_model import CoreDynamics, fill_per_ampere, fill_wound, pull
from haptorb.devices.field_sensors import draw_sensors
from haptorb.errors import DriverError, InputError
from haptorb.estimation.types import Pose, Sample
from haptorb.magnetics.magnets import ChargedRing, charge_field, dipole_on_charges
from haptorb.magnetics.soft_sphere import SoftSphere, add_induced_field
from haptorb.simulation.base import CoilSimulation
from haptorb.simulation.parts import (
    TOOL,
    cold_coils,
    contact,
    fill_normal,
    fill_remaining_rotation,
    fill_tool,
    let_fail,
    make_halls,
    matrix,
    move,
    network_coil_step,
    quantise,
    read_halls,
    read_tool,
    seed_noise,
    set_goal,
)
from haptorb.thermal import ThermalNetwork

__all__ = [
    "COILS",
    "CORE",
    "ELECTROMAGNET",
    "NODES",
    "SENSES",
    "Magnets",
    "SimulatedElectromagnet",
    "advance",
    "core_step",
    "draw_network",
    "fill_step",
    "make_core",
    "pack_magnets",
    "sense",
]


# --------------------------------------------------------------------------------------------------
# The simulated core: a part of its moment lags behind the currents, a part stays when they are gone.


#: How the core departs from one that follows the currents at once.
CORE = fields(
    ("share", "f8"),  # of the moment that lags
    ("time", "f8"),  # constant of the lag [s]
    ("remanent", "f8"),  # moment that stays along an axis [A·m²]
    ("reversing", "f8"),  # change of the moment that reduces the remanence from full to zero [A·m²]
    ("lagging", "f8", (3,)),  # the moment through the lag [A·m²]
    ("play", "f8", (3,)),  # the moment through the play [A·m²]
    ("extra", "f8", (3,)),  # moment beside that of the currents [A·m²]
)


def make_core(dynamics: CoreDynamics) -> Records:
    """(1,) CORE without any history."""
    made = np.zeros(1, dtype=CORE)
    made["share"], made["time"] = dynamics.eddy_share, dynamics.eddy_time
    made["remanent"], made["reversing"] = dynamics.remanent_moment, dynamics.reversing_moment
    return made


@kernel
def core_step(core: Record, moment_per_current: Array, coils: Records, dt: float) -> None:
    """Advance a CORE by `dt` [s], in which the mean currents of `coils` (m,) flow; moment_per_current (3, m) [m²]."""
    gone = -np.expm1(-dt / core.time)
    for a in range(3):
        moment = 0.0
        for k in range(coils.size):
            moment += moment_per_current[a, k] * coils[k].mean
        core.lagging[a] += gone * (moment - core.lagging[a])
        core.play[a] = max(moment - core.reversing, min(moment + core.reversing, core.play[a]))
        stays = core.remanent * (core.play[a] - moment) / core.reversing
        core.extra[a] = stays - core.share * (moment - core.lagging[a])


# --------------------------------------------------------------------------------------------------
# What the sensors of a spherical electromagnet read: currents, coil boundaries, and the field at nine places.
#
# The field at a Hall sensor is that of coils and core (`coil_fields`), of the dipole that eddy currents delay and that
# stays in the core, of the tool's ring as charges on its faces, and of what the core answers
# to the ring, where the sensor really is. What the sensor makes of it is `simulation.parts.hall`'s; every reading has
# normal noise and its converter's step.


#: How good the sensors of currents and temperatures are: standard deviation and step; the generator of all noise.
SENSES = fields(
    ("warming", "f8"),  # rise of the field sensors' temperature as a share of the coils' at their boundary
    ("current_noise", "f8"),  # [A]
    ("current_step", "f8"),  # [A]
    ("heat_noise", "f8"),  # [K]
    ("heat_step", "f8"),  # [K]
    ("generator", "u8", (4,)),
)


class Magnets(NamedTuple):
    """Where fields come from, and where they are read."""

    ring: Array  #: (4, n) charges of the tool's magnet, mover frame [m, A·m]
    coarse: Array  #: (4, n') the same magnet with fewer charges: enough for what the core answers
    core_radius: float  #: [m]
    response: Array  #: (L,) the core's answer by degree
    per_moment: Array  #: (3 k, 3) field of a moment in the core at the sensors [T/(A·m²)]
    per_ampere: Array  #: (3 k, m) field of coils and core at the sensors [T/A]
    sensors: Array  #: (k, 3) where they really are [m]


def pack_magnets(magnets: Magnets) -> Array:
    """(n,) `magnets` as compiled code takes them, each number in the unit [..] of its field."""
    m = magnets
    return pack((m.core_radius,), m.ring, m.coarse, m.response, m.per_moment, m.per_ampere, m.sensors)


@kernel
def _unpack_magnets(blob: Array) -> Magnets:
    return Magnets(
        part(blob, 1), part(blob, 2), part(blob, 0)[0, 0], part(blob, 3)[0], part(blob, 4), part(blob, 5),
        part(blob, 6),
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

    extra (3,) [A·m²]: the electromagnet's moment beside that of its currents.
    """
    ring, coarse, sensors = np.empty_like(magnets.ring), np.empty_like(magnets.coarse), magnets.sensors
    _place_charges(magnets.ring, R, p, ring)
    _place_charges(magnets.coarse, R, p, coarse)
    for k in range(sensors.shape[0]):
        for i in range(3):
            total = 0.0
            for a in range(3):
                total += magnets.per_moment[3 * k + i, a] * extra[a]
            for j in range(coils.size):
                total += magnets.per_ampere[3 * k + i, j] * coils[j].current
            out[k, i] = total
        x, y, z = sensors[k, 0], sensors[k, 1], sensors[k, 2]
        charge_field(ring, x, y, z, out[k])
        add_induced_field(coarse, magnets.core_radius, magnets.response, x, y, z, out[k])


@kernel
def _is_finite(tool: Record) -> bool:
    """Whether pose and motion of a TOOL are numbers."""
    total = tool.q[3]
    for i in range(3):
        total += tool.p[i] + tool.q[i] + tool.v[i] + tool.w[i]
    return bool(np.isfinite(total))


@kernel
def sense(
    electromagnet: Records, coils: Records, halls: Records, magnets: Array, pose: Array, read: Array, field: Array
) -> bool:
    """One reading of each sensor, and the tool's true pose; False, and nothing read, if the tool is nowhere.

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
# How the simulated coils heat each other: not quite as in the device file, and the controller does not know.
#
# Every capacity and conductance is off by itself, within the file's tolerance, and a little heat leaves the core
# through the stand, which the file's network does not have.


COILS = 3
NODES = 2 * COILS + 1  #: windings, bodies, and a core, which uncoupled coils do not warm
_STAND = 0.05  #: conductance of the stand, as a share of that of all bodies to the air


def draw_network(device: Device, specimen: int = 0) -> ThermalNetwork:
    """A network that a `specimen` of `device` could have by its file; the file's own if its values are exact.

    Of one file and number it is always the same: noise changes from run to run, coils do not.
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
        to_air[-1] = _STAND * to_air.sum()
    return replace(network, capacity=spread(network.capacity), exchange=between + between.T, to_air=to_air)


def fill_step(network: ThermalNetwork, dt: float, out: Array) -> None:
    """`out` (7, 10) becomes the network's step over `dt` [s]; a core that is not there keeps its temperature."""
    step, n = network.step(dt), network.nodes
    out[:] = 0.0
    out[-1, NODES - 1] = 1.0
    out[:n, :n], out[:n, NODES:] = step[:, :n], step[:, n:]


# --------------------------------------------------------------------------------------------------
# An electromagnet's physics in compiled code: some steps of coils, core, tool, dome and hand.


#: All that a simulated electromagnet remembers but its coils, and the numbers that it goes by.
ELECTROMAGNET = fields(
    ("tool", TOOL),
    ("senses", SENSES),
    ("nearest", "f8"),  # distance from the centre [m] below which the core's pull is that there
    ("reach", "f8"),  # of `WoundCoils` [m]
    ("wound_from", "f8"),  # distance from the centre [m] below which the coils' field is that there
    ("dt", "f8"),  # of a step [s]
    ("steps", "i8"),  # in one call
    ("heat", "f8", (NODES, NODES + COILS)),  # `ThermalNetwork.step` of a step
    ("core_temperature", "f8"),  # temperature of what lies between the coils [K]
    ("core", CORE),
    ("wrench", "f8", (6,)),  # of coils and core on the tool, mean of the last call [N, N·m]
    ("depth", "f8"),  # how far the dome gives way under the tool [m]
)


@kernel
def advance(
    electromagnet: Records, coils: Records, duties: Array, wish_p: Array, wish_q: Array, rows: Array, table: Array,
    moment_per_current: Array, terms: Array, axes: Array,
) -> None:  # fmt: skip
    """Some steps of coils, core, tool, dome and hand: `electromagnet` (1,) ELECTROMAGNET and `coils` (m,) COIL advance.

    duties (m,); the hand goes to wish_p (3,) [m] and wish_q (4,) where they are numbers and a turn, else to where it
    went; rows (4, n) charges of the tool's magnet; table of the core's pull; moment_per_current (3, m) [m²]; terms and
    axes of `WoundCoils`, terms (m, 0) for coils that are points.
    """
    e = electromagnet[0]
    tool, truth, dt, count = e.tool, e.wrench, e.dt, coils.size
    set_goal(tool, wish_p, wish_q)
    R = np.empty((3, 3))
    per_moment, per_current = np.empty((6, 3)), np.empty((6, count))
    given, total, passive = np.empty(6), np.empty(6), np.empty(6)
    turn, axis = np.empty(3), np.empty(3)
    for k in range(count):
        coils[k].duty = duties[k]
    truth[:] = 0.0
    for _ in range(e.steps):
        matrix(tool.q[:], R)
        dipole_on_charges(rows, R, tool.p[:], per_moment)
        if terms.shape[1]:
            fill_wound(rows, terms, e.reach, e.wound_from, axes, tool.p[:], R, per_current)
        else:
            fill_per_ampere(per_moment, moment_per_current, per_current)
        for i in range(3):
            axis[i] = R[i, 2]
        passive[:] = 0.0
        pull(table, e.nearest, tool.p[:], axis, passive)
        for k in range(count):  # the power that leaves the coil's circuit is the power that the tool gets
            emf = 0.0
            for i in range(3):
                emf += per_current[i, k] * tool.v[i]
            for i in range(3):
                emf += per_current[3 + i, k] * tool.w[i]
            coils[k].emf = emf
        e.core_temperature = network_coil_step(coils, e.heat, e.core_temperature, dt)
        core_step(e.core, moment_per_current, coils, dt)
        for i in range(6):
            given[i] = passive[i]
            for k in range(count):
                given[i] += per_current[i, k] * coils[k].mean
            for k in range(3):
                given[i] += per_moment[i, k] * e.core.extra[k]
            truth[i] += given[i] / e.steps
            total[i] = given[i]
        e.depth = contact(tool, R, dt, total)
        fill_remaining_rotation(tool.q, tool.goal_q, turn)
        move(tool, R, turn, total, dt)


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
        self._per_ampere = np.array(device.far_moments, dtype=np.float64, order="C")
        self._terms, self._axes = np.zeros((device.channels, 0)), np.zeros((device.channels, 3))
        if device.has_sizes:
            wound = device.wound_coils
            self._terms, self._axes = wound.terms, wound.axes
            self._state["reach"], self._state["wound_from"] = wound.reach, wound.nearest
        nominal = np.array(hall.positions, dtype=np.float64, order="C").reshape(-1, 3)
        drawn = draw_sensors(hall.errors, len(nominal), specimen)
        self._halls = make_halls(np.tile(np.eye(3), (len(nominal), 1, 1)), drawn, hall)
        self._state["core"] = make_core(device.core_dynamics.draw(specimen))
        positions = np.ascontiguousarray(nominal + drawn.placement)
        sphere = SoftSphere(device.core_radius, device.core_permeability)
        order = 1
        if len(positions):
            closest = max(device.dome_radius - tool.length / 2, 1.1 * device.core_radius)
            order = sphere.order(closest, float(np.linalg.norm(positions, axis=1).min()), precision=1e-3)
        unit = point_field(positions)
        self._magnets = pack_magnets(
            Magnets(
                self._rows,
                ChargedRing(*size, radial=1, azimuth=4).rows,
                float(device.core_radius),
                sphere.response(order),
                np.ascontiguousarray(unit.reshape(-1, 3)),
                np.ascontiguousarray(device.coil_fields(positions).reshape(-1, device.channels)),
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
            advance(
                self._state, self._coils, duties, goal_p, goal_q, self._rows, self._table, self._per_ampere,
                self._terms, self._axes,
            )  # fmt: skip
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
