"""Spherical electromagnet that attracts and repels a magnet in a tool: Zárate 2020's Omni and variants."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import pairwise, product
from typing import ClassVar

import numpy as np
from numpy import ascontiguousarray

from haptorb.arrays import Array, cap_directions
from haptorb.devices.base import (
    Coils,
    Device,
    DeviceKind,
    Shell,
    State,
    WrenchMap,
    rotation_to_axis,
)
from haptorb.devices.build_checks import CERTAIN, BuildCheck, check_wire, compare_fill
from haptorb.devices.core_parameters import CoreDynamics
from haptorb.devices.electromagnet_wrench_map import (
    Windings,
    WoundCoils,
    pack_wound_ring,
    ring_per_ampere,
    wound_per_ampere,
)
from haptorb.devices.field_sensors import FieldSensors
from haptorb.devices.geometry import Ball, Geometry, Reach, Rod, RoundPart, Spot, list_assumed
from haptorb.devices.magnet_grades import ANY_MAGNET, MagnetUse, check_magnet
from haptorb.devices.schema import list_limit_remarks
from haptorb.devices.touch_points import Marks
from haptorb.devices.uncertainty import ElectromagnetTolerance, ToolUncertainty
from haptorb.display import format_quantity
from haptorb.errors import GeometryError
from haptorb.magnetics.core_attraction import PassivePull
from haptorb.magnetics.dipole import MU0, MU0_OVER_4PI, dipole_per_ampere, point_field
from haptorb.magnetics.magnets import ChargedRing, CylinderMagnet, RingMagnet
from haptorb.magnetics.soft_sphere import SoftSphere

__all__ = [
    "CHIP_EDGE_M",
    "COILS_AS_POINTS",
    "CORE_SATURATION",
    "ELECTROMAGNET",
    "FORCE_JND",
    "GREATEST_LEAN",
    "PEN_RADIUS_M",
    "DomeContact",
    "Hand",
    "SphericalElectromagnet",
    "Tool",
    "check_windings",
    "electromagnet_geometry",
    "find_sensor_field",
    "list_geometry_mistakes",
    "list_remarks",
    "pen_distance",
]


# --------------------------------------------------------------------------------------------------
# The record of spherical electromagnets: a magnet in a tool over a dome, moved by the force of coils.


ELECTROMAGNET = DeviceKind(
    name="spherical-electromagnet",
    title="spherical electromagnet",
    world="dome",
)


# --------------------------------------------------------------------------------------------------
# Remarks on an electromagnet: inconsistent values of its file, which prevent no computation.


FORCE_JND = 0.07  #: just-noticeable difference of a force, lower end of the published 7 to 10 %
CORE_SATURATION = 1.5  #: knee of the magnetisation curve of low-carbon steel [T]
COILS_AS_POINTS = "coils are taken for points (no [windings] inside the dome): a third of the force may be wrong"
PEN_RADIUS_M = 7e-3  #: radius of the pen around the tool's magnet [m]
CHIP_EDGE_M = 3e-3  #: from a field sensor's centre to the farthest edge of its chip, with air [m]
GREATEST_LEAN = np.radians(15.0)  #: of a tool against the radius, at most, in tests of what stands in its way


def list_remarks(
    coils: Coils, predicted: Array | None, moments: Array, moments_from: str, moments_at: float = np.inf
) -> tuple[str, ...]:
    """Sentences about a device whose `moments` (3, 3) [m²] per ampere come from `moments_from`; none is a pass.

    One where they differ in size by what a hand can feel from those that are `predicted` (3, 3) from windings and core:
    a force goes with the moment.
    """
    if predicted is None or moments_from == "windings":
        return ()
    sizes = (np.linalg.norm(matrix, axis=0).tolist() for matrix in (moments, predicted))
    pairs = list(zip(coils.names, *sizes, strict=True))
    if not any(abs(computed / used - 1) > FORCE_JND for _, used, computed in pairs):
        return ()
    differences = "; ".join(
        f"coil {name}: {used:.4f} m², windings and core give {computed:.4f} m² ({100 * (computed / used - 1):+.0f} %)"
        for name, used, computed in pairs
    )
    origin, remedy = "moment_per_current", "correct one of them, or state windings.fill to use [windings]"
    if moments_from == "calibration":
        origin, remedy = "the calibration", "correct [windings]"
    place = "" if np.isinf(moments_at) else f" by the fields {1e3 * moments_at:g} mm from the centre"
    return (f"moments differ{place}: {differences}. The strength of forces follows {origin}; {remedy}",)


# --------------------------------------------------------------------------------------------------
# Buildability checks of an electromagnet: wire in its section, nested windings, and the dome.


def check_windings(
    windings: Windings, coils: Coils, core_radius: float, free_radius: float, spread: float
) -> list[BuildCheck]:
    """Of windings around a core of `core_radius` [m], inside a wall of radius `free_radius` [m].

    spread: relative standard uncertainty of the coils' resistance.
    """
    resistivity = coils.copper_resistivity
    wires = windings.wires(coils.resistance, resistivity)
    found = []
    origin = "" if windings.wire is not None else ", the wire that gives coils.resistance"
    for k, (name, (copper, overall)) in enumerate(zip(coils.names, wires.tolist(), strict=True)):
        found.append(
            BuildCheck(
                "windings outside the core", f"coil {name}, its inner radius",
                float(windings.inner_radius[k]), core_radius, "m",
                "increase windings.inner_radius or reduce electromagnet.core_radius", at_least=True,
            )
        )  # fmt: skip
        check, layers = check_wire(f"coil {name}", windings.coils[k], copper, overall, origin)
        found.append(check)
        if layers is not None and windings.wire is not None:
            made, stated = layers.resistance(copper, resistivity), float(coils.resistance[k])
            found.append(
                BuildCheck(
                    "wire with the stated resistance", f"coil {name}, relative difference of the two",
                    abs(made / stated - 1), CERTAIN * spread, "1",
                    "correct coils.resistance, turns or wire, or increase uncertainty.resistance",
                    note=f"{layers.wire_length:.3g} m of wire: {made:.3g} Ω instead of {stated:g} Ω",
                )
            )  # fmt: skip
        if windings.copper_share is not None:
            made, stated = windings.coils[k].resistance(windings.copper_share, resistivity), float(coils.resistance[k])
            found.append(compare_fill(f"coil {name}", made, stated, spread))
    order, corners = np.argsort(windings.inner_radius).tolist(), windings.corners.tolist()
    for inside, outside in pairwise(order):
        found.append(
            BuildCheck(
                "windings that cross without touching",
                f"coil {coils.names[inside]} inside coil {coils.names[outside]}",
                corners[inside], float(windings.inner_radius[outside]), "m",
                "increase windings.inner_radius of the outer one, or make the inner one shorter or thinner",
                note="from the centre to the corner of the inner winding",
            )
        )  # fmt: skip
    last = int(np.argmax(corners))
    found.append(
        BuildCheck(
            "windings inside the dome", f"coil {coils.names[last]}", corners[last], free_radius, "m",
            "reduce windings.outer_radius or windings.length, or dome.wall, or increase dome.radius",
            note="from the centre to the corner of the winding",
        )
    )  # fmt: skip
    return found


def find_opposing_field(device: SphericalElectromagnet) -> float:
    """Greatest field [T] of all coils at their peak, each in its worse sense, against the tool's magnet.

    At its lower face, in contact anywhere in the workspace, the tool radial or leaning to any side. The core's response
    to the magnet itself helps it, and is left out.
    """
    places, axes = [], []
    for radial in cap_directions(device.workspace_half_angle, _DIRECTIONS):
        first, second = rotation_to_axis(radial)[:, :2].T
        sides = 2 * np.pi * np.arange(4) / 4
        away = np.outer(np.cos(sides), first) + np.outer(np.sin(sides), second)
        for axis in np.vstack([radial, np.cos(GREATEST_LEAN) * radial + np.sin(GREATEST_LEAN) * away]):
            axes.append(axis)
            places.append(device.dome_radius * radial + (device.tool.tip_distance - device.tool.length / 2) * axis)
    along = np.einsum("nak,na->nk", device.coil_fields(np.array(places)), np.array(axes))
    return float((np.abs(along) @ device.driven_current).max())


_DIRECTIONS, _SIDES = 16, 8  #: places of a tool over the workspace, and sides to which it leans


def find_sensor_field(device: SphericalElectromagnet) -> Array:
    """(k,) upper bound of the reading of an axis of each field sensor [T].

    Of a tool in contact anywhere in the workspace, radial or leaning by GREATEST_LEAN to any side, and all coils at the
    current that the supply drives: the magnet by charges on its faces, the core's response to it as a dipole.
    """
    tool, at = device.tool, device.hall.positions
    azimuth = np.arctan2(at[:, 1], at[:, 0])
    half = device.workspace_half_angle
    edge = np.stack([np.sin(half) * np.cos(azimuth), np.sin(half) * np.sin(azimuth), np.full(len(at), np.cos(half))], 1)
    rows = ChargedRing(tool.outer_radius, tool.inner_radius, tool.length, tool.remanence, radial=3, azimuth=12).rows
    greatest = np.zeros(len(at))
    for radial in np.vstack([edge, cap_directions(half, _DIRECTIONS)]):
        first, second = rotation_to_axis(radial)[:, :2].T
        sides = 2 * np.pi * np.arange(_SIDES) / _SIDES
        away = np.outer(np.cos(sides), first) + np.outer(np.sin(sides), second)
        leaning = np.cos(GREATEST_LEAN) * radial + np.sin(GREATEST_LEAN) * away
        axes = np.vstack([radial, leaning])
        turns = np.array([rotation_to_axis(axis) for axis in axes])
        middles = device.dome_radius * radial + tool.tip_distance * axes
        charges = middles[:, None] + np.einsum("sab,bn->sna", turns, rows[:3])  # (sides, charges, 3)
        x, y, z = (at[:, i, None, None] - charges[..., i] for i in range(3))  # (k, sides, charges)
        square = x * x + y * y + z * z
        strength = MU0_OVER_4PI * rows[3] / (square * np.sqrt(square))
        for apart in (x, y, z):
            greatest = np.maximum(greatest, np.abs((strength * apart).sum(axis=2)).max(axis=1))
    per_ampere, away = device.coil_fields(at), np.linalg.norm(at, axis=1)[:, None, None]
    # the core's response to the tool: the moment 4π a³ B/µ0 of a soft sphere, on whose axis the sensor is at worst
    at_core = MU0 * tool.moment / (2 * np.pi * (device.contact_distance * np.cos(GREATEST_LEAN)) ** 3)
    response = 2.0 * at_core * (device.core_radius / away[:, 0, 0]) ** 3
    found: Array = greatest + np.abs(per_ampere).max(axis=1) @ device.driven_current + response
    return found


def pen_distance(device: SphericalElectromagnet, points: Array, lean: float) -> Array:
    """(k,) least distance [m] of `points` (k, 3) [m] from the axis of a pen whose tip is on the dome, anywhere within
    the workspace, and which leans up to `lean` [rad] against the radius, to any side; the pen is long."""
    points = np.asarray(points)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    turns, angles = np.radians(np.arange(-60.0, 61.0, 5.0)), device.workspace_half_angle * np.array([0.6, 0.8, 1.0])
    sides, leans = 2 * np.pi * np.arange(16) / 16, lean * np.array([0.0, 0.5, 1.0])
    turn, angle, side, tilt = (one.ravel() for one in np.meshgrid(turns, angles, sides, leans, indexing="ij"))
    out = np.empty(len(points))
    for k, (point, middle) in enumerate(zip(points, azimuth, strict=True)):
        c, s = np.cos(middle + turn), np.sin(middle + turn)
        zero = np.zeros_like(c)
        radial = np.stack([np.sin(angle) * c, np.sin(angle) * s, np.cos(angle)], axis=1)
        south = np.stack([np.cos(angle) * c, np.cos(angle) * s, -np.sin(angle)], axis=1)
        east = np.stack([-s, c, zero], axis=1)
        away = np.cos(side)[:, None] * south + np.sin(side)[:, None] * east
        axis = np.cos(tilt)[:, None] * radial + np.sin(tilt)[:, None] * away
        from_tip = point - device.dome_radius * radial
        along = np.maximum((from_tip * axis).sum(axis=1), 0.0)
        out[k] = np.linalg.norm(from_tip - along[:, None] * axis, axis=1).min()
    return out


#: Tabulated once for all copies of a device with the same tool and core: a calibration or an error analysis makes
#: hundreds, and the table takes a twentieth of a second.
_make_pull = lru_cache(maxsize=64)(PassivePull)


@dataclass(frozen=True)
class Tool:
    """A stylus with a ring magnet; the moment lies along the mover's +z, the tip at −z."""

    outer_radius: float  #: [m]
    inner_radius: float  #: [m]
    length: float  #: [m]
    remanence: float  #: [T]
    tip_distance: float  #: from the magnet's centre to the tip [m]
    mass: float  #: [kg]
    inertia: Array  #: (3,) principal moments about the magnet's centre, mover frame [kg·m²]
    worn: bool = False  #: on a fingertip, not in a pen; for pictures and words
    use: MagnetUse = ANY_MAGNET  #: grade and temperature of the magnet

    @property
    def moment(self) -> float:
        """Magnetic moment m_p [A·m²]: remanence times volume over μ0."""
        volume = np.pi * (self.outer_radius**2 - self.inner_radius**2) * self.length
        return float(self.remanence * volume / MU0)


@dataclass(frozen=True)
class Hand:
    """Hand that holds the tool: added mass, springs and dampers."""

    mass: float  #: [kg]
    damping: float  #: [N·s/m]
    stiffness: float  #: [N/m]
    turn_damping: float  #: [N·m·s/rad]
    turn_stiffness: float  #: [N·m/rad]


@dataclass(frozen=True)
class DomeContact:
    """The dome under the tip: a stiff spring with damping and dry friction."""

    stiffness: float  #: [N/m]
    damping: float  #: [N·s/m]
    friction: float  #: coefficient [1]


@dataclass(frozen=True, kw_only=True)
class SphericalElectromagnet(Device):
    """Three coils around one soft-magnetic sphere, and a magnet in a tool that moves over a dome (Zárate 2020).

    Built from a device file of the kind "spherical-electromagnet". Parameters beside those of `haptorb.Device`:

    Parameters
    ----------
    moment_per_current : ndarray, shape (3, 3)
        Moment of the electromagnet per ampere [m²]: m_e = moment_per_current @ currents [A·m²], of the dipole that has
        a coil's field on its axis at the distance `moments_at`.
    moments_at : float
        Where that holds [m]; inf: far away.
    coil_centres : ndarray, shape (3, 3), optional
        From where each coil's field comes, where a calibration found it [m].
    core_radius : float
        Radius of the core [m].
    core_permeability : float
        Relative permeability of the core [1]; may be infinite.
    core_saturation : float
        Flux density up to which that holds [T].
    dome_radius : float
        Outer radius of the dome [m].
    dome_wall : float
        Thickness of the dome's wall [m].
    shell_thickness : float
        Height above contact up to which forces are rendered [m].
    workspace_half_angle : float
        Half angle of the workspace from +z [rad].
    tool : Tool
        Tool with its magnet.
    hand : Hand
        Simulated hand that holds the tool.
    contact : DomeContact
        Contact of the tool with the dome.
    hall : FieldSensors
        Field sensors on the stator.
    thermometer_step : float
        Resolution of the thermometers [K].
    thermometer_noise : float
        Standard deviation of one temperature reading [K].
    windings : Windings, optional
        Sizes of the coils, where given or assumed.
    moments_from : str
        Where `moment_per_current` comes from: "device file", "windings" or "calibration".
    core_dynamics : CoreDynamics
        Eddy currents and remanence of the core.
    marks : Marks, optional
        Places to touch with the tip, for the registration of a tracker.
    uncertainty : ToolUncertainty
        Standard uncertainties of the values, for the error budget.
    tolerance : ElectromagnetTolerance or None
        How far what is built may be from these values, for the simulation and the error budget; None: it is the same.

    Notes
    -----
    Model "exact", where `windings` are known: coils, core and the tool's magnet at their true size, and the pull of the
    core on the magnet. Model "point-coils": the same with each coil and its core as a point dipole at the centre.
    Model "published": two point dipoles, Zárate 2020 eqs. (1)–(2). The coils' axes and strengths are those of
    `moment_per_current` in all.
    """

    kind: ClassVar[DeviceKind] = ELECTROMAGNET

    moment_per_current: Array
    core_radius: float
    core_permeability: float
    dome_radius: float
    shell_thickness: float
    workspace_half_angle: float
    tool: Tool
    hand: Hand
    contact: DomeContact
    hall: FieldSensors
    thermometer_step: float
    thermometer_noise: float
    dome_wall: float = 0.0
    core_saturation: float = CORE_SATURATION
    windings: Windings | None = None
    moments_from: str = "device file"
    moments_at: float = np.inf
    coil_centres: Array | None = None
    core_dynamics: CoreDynamics = field(default_factory=CoreDynamics)
    marks: Marks | None = None
    uncertainty: ToolUncertainty = field(default_factory=lambda: ToolUncertainty.model_validate({}))
    tolerance: ElectromagnetTolerance | None = field(default_factory=lambda: ElectromagnetTolerance.model_validate({}))

    def __post_init__(self) -> None:
        known = ("exact", "point-coils", "published") if self.has_sizes else ("point-coils", "published")
        object.__setattr__(self, "models", tuple(one for one in self.models if one in known) or known)

    def with_recorded_models(self, noted: tuple[str, ...]) -> SphericalElectromagnet:
        """As of every device; in recordings from before there were "point-coils", these are called "exact"."""
        noted = noted or ("exact", "published")
        if "point-coils" not in noted:
            noted = tuple("point-coils" if one == "exact" else one for one in noted)
        return replace(self, models=noted)

    @property
    def tick_models(self) -> tuple[str, ...]:
        """All: each takes microseconds."""
        return self.models

    @property
    def contact_distance(self) -> float:
        """Distance of the tool's magnet from the centre when a radial tool touches the dome: d_min [m]."""
        return self.dome_radius + self.tool.tip_distance

    @property
    def shell(self) -> Shell:
        """Workspace of the tool."""
        return Shell(self.contact_distance, self.shell_thickness, self.tool.moment, self.dome_radius)

    @property
    def rest_position(self) -> Array:
        """(3,) just above contact, over the summit [m]."""
        return np.array([0.0, 0.0, 1.1 * self.contact_distance])

    @property
    def sensors(self) -> int:
        """Number of three-axis field sensors."""
        return len(self.hall.positions)

    @cached_property
    def passive_pull(self) -> PassivePull:
        """Attraction between the core and the tool's magnet at zero current, erratum E18."""
        tool = self.tool
        return _make_pull(
            core_radius=self.core_radius,
            core_permeability=self.core_permeability,
            outer_radius=tool.outer_radius,
            inner_radius=tool.inner_radius,
            length=tool.length,
            remanence=tool.remanence,
            nearest=self.core_radius + tool.length / 2 + 5e-3,
        )

    @property
    def core(self) -> SoftSphere:
        """The coils' core."""
        return SoftSphere(self.core_radius, self.core_permeability)

    @property
    def has_sizes(self) -> bool:
        """Whether the coils' sizes are known and they lie within the dome, as the model "exact" needs."""
        if self.windings is None:
            return False
        return float(self.windings.corners.max()) < self.dome_radius

    @property
    def build_checks(self) -> tuple[BuildCheck, ...]:
        """Buildability checks of this device."""
        tool, coils = self.tool, self.coils
        # a leaning tool's magnet touches the dome with the rim of its lower face
        lean = float(np.arctan2(tool.tip_distance - tool.length / 2, tool.outer_radius))
        found = [
            *super().build_checks,
            BuildCheck(
                "magnet above the dome", "lean of the tool at which its magnet touches it", lean, GREATEST_LEAN, "rad",
                "increase tool.tip_distance, or make the magnet shorter or thinner", at_least=True,
            ),
            *check_magnet(
                "tool", "tool.remanence",
                RingMagnet(tool.outer_radius, tool.inner_radius, tool.length, tool.remanence) if tool.inner_radius
                else CylinderMagnet(tool.outer_radius, tool.length, tool.remanence),
                tool.use, coils.heat.stop, 0.0, find_opposing_field(self),
            ),
        ]  # fmt: skip
        if self.hall.range is not None and self.sensors:
            fields = find_sensor_field(self)
            worst = int(np.argmax(fields))
            found.append(
                BuildCheck(
                    "fields within the sensors' range", f"sensor {worst + 1}, tool and coils together",
                    float(fields[worst]), self.hall.range, "T",
                    "move the sensor away from tool and coils, or take one with a greater range (hall.range)",
                )
            )  # fmt: skip
        outside = np.linalg.norm(self.hall.positions.reshape(-1, 3), axis=1) > self.dome_radius
        if outside.any():
            away = np.full(len(outside), np.inf)
            away[outside] = pen_distance(self, self.hall.positions[outside], GREATEST_LEAN)
            worst = int(np.argmin(away))
            found.append(
                BuildCheck(
                    "tool clear of the sensors", f"sensor {worst + 1}, from its centre to a leaning tool's axis",
                    float(away[worst]), max(PEN_RADIUS_M, self.tool.outer_radius) + CHIP_EDGE_M, "m",
                    "move the sensor down or outwards, or reduce dome.workspace_half_angle", at_least=True,
                    note=f"{1e3 * max(PEN_RADIUS_M, self.tool.outer_radius):g} mm of tool and "
                    f"{1e3 * CHIP_EDGE_M:g} mm of chip",
                )
            )  # fmt: skip
        if self.windings is not None:
            found.append(
                BuildCheck(
                    "core below its saturation", "flux density, coils at their peak and tool in contact",
                    self._measure_flux(self.windings), self.core_saturation, "T",
                    "reduce turns or coils.current_limit, or increase electromagnet.core_radius",
                )
            )  # fmt: skip
            free, spread = self.dome_radius - self.dome_wall, self.uncertainty.resistance
            found += check_windings(self.windings, coils, self.core_radius, free, spread)
        return tuple(found)

    def predict_moments(self) -> Array | None:
        """(3, 3) [m²] m_e per ampere from the coils' sizes and the core, to be held against `moment_per_current`; None
        where the sizes are not known."""
        return None if self.windings is None else self.windings.moment_per_current(self.core, self.moments_at)

    def _measure_flux(self, windings: Windings) -> float:
        """[T] in the core: three times the field that would be there without it (a soft sphere, Jackson §5.11).

        Of every coil where its field in the core's place is greatest, on the core's equator (Biot and Savart over
        filaments), and of the tool's dipole at the core's near side; all added, as if they had one direction.
        """
        a = self.core_radius
        total = MU0 * self.tool.moment / (2 * np.pi * (self.contact_distance - a) ** 3)
        phi = 2 * np.pi * (np.arange(90) + 0.5) / 90
        for coil, current in zip(windings.coils, self.driven_current.tolist(), strict=True):
            radii, heights, turns = (one.ravel()[:, None] for one in coil.filaments(6, 24))
            square = a * a + radii**2 - 2 * a * radii * np.cos(phi) + heights**2
            axial = (turns * radii * (radii - a * np.cos(phi)) / square**1.5).sum() * 2 * np.pi / len(phi)
            total += MU0_OVER_4PI * current * float(axial)
        return 3.0 * total

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on inconsistent values of this device, which prevent no computation."""
        predicted = self.predict_moments()
        moments = list_remarks(self.coils, predicted, self.moment_per_current, self.moments_from, self.moments_at)
        points = () if self.has_sizes else (COILS_AS_POINTS,)
        return (*points, *moments, *list_limit_remarks(self.coils, self.supply, self.limits, *self.greatest_wrench))

    @property
    def greatest_wrench(self) -> tuple[float, float]:
        """Maximum force [N] and torque [N·m] on a radial tool in contact at the summit, all coils at full current.

        By the published model, which takes coils and tool for dipoles.
        """
        corners = np.array(list(product((-1.0, 1.0), repeat=self.channels))) * self.driven_current
        moments = corners @ self.moment_per_current.T
        scale = MU0 * self.tool.moment / (4 * np.pi * self.contact_distance**3)
        across, along = np.hypot(moments[:, 0], moments[:, 1]), moments[:, 2]
        force = 3 * scale / self.contact_distance * np.hypot(across, 2 * along)
        return float(force.max()), float((scale * across).max())

    def geometry(self) -> Geometry:
        """The parts of the device, its tool in contact."""
        return electromagnet_geometry(self)

    def wrench_map(self, state: State, model: str) -> WrenchMap:
        """(6, 3) per ampere and (6,) passive, torque about the tool's magnet; GeometryError inside the dome's core."""
        x, y, z = state.p.tolist()
        if x * x + y * y + z * z < self._closest_square:
            raise GeometryError(
                f"device '{self.name}': a tool magnet at {state.distance * 1e3:.1f} mm from the centre would be inside "
                f"the core; contact is at {self.contact_distance * 1e3:.1f} mm"
            )
        matrix, passive = np.empty((6, self.channels)), np.zeros(6)
        p, R = ascontiguousarray(state.p), ascontiguousarray(state.R_SR)
        if model == "exact" and "exact" in self.models:
            wound_per_ampere(self._wound_ring, p, R, matrix, passive)
        elif model == "point-coils":
            ring_per_ampere(*self._ring, p, R, matrix, passive)
        else:
            self.check_model(model)
            dipole_per_ampere(*self._dipole, p, R, matrix)
        return WrenchMap(matrix, passive, self.coils.names)

    def coil_fields(self, points: Array) -> Array:
        """(n, 3, m) [T/A] field of each coil with the core's response, at `points` (n, 3) [m] outside the core.

        Of coils whose sizes are known at their true size, else of point dipoles.
        """
        at = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        if self.windings is not None and self.has_sizes and len(at):
            known = self.core, self.moment_per_current, self.moments_at
            return self.windings.field(*known, at, centres=self.coil_centres)
        return point_field(at) @ self.moment_per_current

    @cached_property
    def far_moments(self) -> Array:
        """(3, m) [m²] moment per ampere as it is seen from far away."""
        if self.windings is None or not self.has_sizes:
            return self.moment_per_current
        return self.windings.far_moments(self.core, self.moment_per_current, self.moments_at)

    def _list_facts(self) -> list[tuple[str, str]]:
        contact, shell = format_quantity(self.contact_distance, "m"), format_quantity(self.shell_thickness, "m")
        angle = f"±{np.degrees(self.workspace_half_angle):.0f}° about the summit"
        head, tail = Device._list_facts(self)[:2], Device._list_facts(self)[2:]
        return [
            *head,
            ("workspace", f"{angle}, magnet {contact} from the centre in contact, rendered {shell} above it"),
            ("tool", f"moment {format_quantity(self.tool.moment, 'A·m²')}, {1e3 * self.tool.mass:.3g} g"),
            ("moments per ampere", f"from the {self.moments_from}"),
            *tail,
            *(("remark", remark) for remark in self.remarks),
        ]

    @cached_property
    def _closest_square(self) -> float:
        """Square of the distance below which the tool's magnet would reach into the core [m²]."""
        return (self.core_radius + 0.5 * self.tool.length) ** 2

    @cached_property
    def _dipole(self) -> tuple[float, Array]:
        """The tool as a point dipole, as kernels take it."""
        return self.tool.moment, np.array(self.moment_per_current, dtype=np.float64, order="C")

    @cached_property
    def wound_coils(self) -> WoundCoils:
        """Coils and core at their true size, as kernels take them, for `has_sizes`."""
        assert self.windings is not None
        closest = max(self.contact_distance - self.tool.length / 2, self.dome_radius)
        known = self.core, self.moment_per_current, self.moments_at, self.dome_radius
        return self.windings.wound(*known, closest, self.coil_centres)

    @cached_property
    def ring_charges(self) -> Array:
        """(4, n) [m], [A·m] charges of the tool's magnet over wound coils: right to 1e-4 of the force in contact."""
        tool = self.tool
        return ChargedRing(tool.outer_radius, tool.inner_radius, tool.length, tool.remanence, radial=2, azimuth=6).rows

    @cached_property
    def _wound_ring(self) -> Array:
        """The tool's magnet, the core's attraction, and the coils, as `wound_per_ampere` takes them."""
        return pack_wound_ring(self.ring_charges, self.passive_pull, self.wound_coils)

    @cached_property
    def _ring(self) -> tuple[Array, Array, float, Array]:
        """The tool's magnet and the core's attraction, as kernels take them."""
        tool, core = self.tool, self.passive_pull
        rows = ChargedRing(tool.outer_radius, tool.inner_radius, tool.length, tool.remanence).rows
        per_current = np.array(self.moment_per_current, dtype=np.float64, order="C")
        return rows, np.array(core.table), float(core.nearest), per_current


# --------------------------------------------------------------------------------------------------
# The bodies of a spherical electromagnet: core, windings, dome, field sensors, marks, and the tool in contact.


_SIZES = (
    "electromagnet.core_radius", "windings.inner_radius", "windings.outer_radius", "windings.length", "dome.radius",
    "dome.shell_thickness", "dome.workspace_half_angle", "tool.outer_radius", "tool.inner_radius", "tool.length",
    "tool.tip_distance", "hall.positions", "marks.positions",
)  # fmt: skip


def electromagnet_geometry(device: SphericalElectromagnet) -> Geometry:
    """The parts of `device`, its tool radial and in contact over the summit.

    A coil's axis is the direction of its moment per ampere: what a calibration measured of it.
    """
    tool, contact = device.tool, device.contact_distance
    place = np.array([0.0, 0.0, contact])
    magnet = RoundPart(
        "tool magnet", "magnet", place, np.array([0.0, 0.0, 1.0]), tool.inner_radius, tool.outer_radius, tool.length,
        polarity=1.0, moves=True,
    )  # fmt: skip
    inside = device.dome_radius - device.dome_wall if device.dome_wall else 0.0
    notes = [
        f"not stated in the device file: the {'finger' if device.tool.worn else 'stylus'} around the tool's magnet"
    ]
    if device.windings is None:
        notes.insert(0, "not to scale: the windings' radii and lengths, as the device file has no [windings]")
    return Geometry(
        round_parts=(*_coils(device), magnet),
        balls=(Ball("core", "core", device.core_radius), Ball("dome", "dome", device.dome_radius, inside)),
        spots=(
            *(Spot(f"sensor {number}", "sensor", at) for number, at in enumerate(device.hall.positions, 1)),
            *(() if device.marks is None else
              (Spot(name, "mark", at) for name, at in zip(device.marks.names, device.marks.positions, strict=True))),
        ),
        rods=(Rod("tool axis", np.array([0.0, 0.0, device.dome_radius]), place),),
        reach=Reach("tool magnet", device.workspace_half_angle, contact, contact + device.shell_thickness),
        notes=(*notes, *list_assumed(device.assumed, _SIZES)),
    )  # fmt: skip


def _coils(device: SphericalElectromagnet) -> tuple[RoundPart, ...]:
    axes = (device.moment_per_current / np.linalg.norm(device.moment_per_current, axis=0)).T
    centre, names, windings = np.zeros(3), device.coils.names, device.windings
    if windings is None:
        # nested in equal layers between core and dome: some size is needed to show the axes
        edges = np.linspace(device.core_radius, device.dome_radius, 2 * len(names) + 3)[1:-1]
        return tuple(
            RoundPart(
                name, "coil", centre, axis, float(edges[2 * k]), float(edges[2 * k + 1]), 0.6 * device.dome_radius,
                channel=name, stated=False,
            )
            for k, (name, axis) in enumerate(zip(names, axes, strict=True))
        )  # fmt: skip
    return tuple(
        RoundPart(
            name, "coil", centre, axis, float(windings.inner_radius[k]), float(windings.outer_radius[k]),
            float(windings.length[k]), channel=name,
        )
        for k, (name, axis) in enumerate(zip(names, axes, strict=True))
    )  # fmt: skip


# --------------------------------------------------------------------------------------------------
# Places of an electromagnet's file that cannot be, although every value by itself is well-formed.


_MAX_MARK_DEPTH_M = 2e-3  #: how deep a dot in the dome may be [m]


def list_geometry_mistakes(
    core_radius: float, dome_radius: float, sensors: Array, mark_names: tuple[str, ...], marks: Array
) -> list[str]:
    """Sentences; none is a pass. Radii [m], sensors (n, 3) and marks (k, 3) in the stator frame [m]."""
    found = []
    for name, distance in zip(mark_names, np.linalg.norm(marks, axis=1), strict=True):
        if distance < dome_radius - _MAX_MARK_DEPTH_M:
            found.append(
                f"marks.positions: mark '{name}' is {distance * 1e3:.3g} mm from the centre, inside the dome "
                f"({dome_radius * 1e3:g} mm), where no tip can touch it; give the bottom of its dot, at most "
                f"{_MAX_MARK_DEPTH_M * 1e3:g} mm below the dome's surface, in the stator frame"
            )
    for number, distance in enumerate(np.linalg.norm(sensors, axis=1), 1):
        if distance < core_radius:
            found.append(
                f"hall.positions: sensor {number} is {distance * 1e3:.3g} mm from the centre, inside the core "
                f"({core_radius * 1e3:g} mm); state its position in the stator frame"
            )
    return found
