"""Coil array: any number of round coils, an optional soft core, and a hand-held tool or plate with magnets."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, final

import numpy as np

from haptorb.arrays import Array, Records, cap_directions
from haptorb.devices.base import Device, DeviceKind, Shell, State, WrenchMap, rotation_to_axis
from haptorb.devices.build_checks import BuildCheck
from haptorb.devices.coil_array_wrench_map import (
    CORE_RULE,
    FREE,
    IN_CORE,
    MAGNET,
    RULES,
    ArrayMap,
    array_wrench,
)
from haptorb.devices.electromagnet import DomeContact, Hand
from haptorb.devices.geometry import Ball, Geometry, Reach, Rod, RoundPart, list_assumed
from haptorb.devices.magnet_grades import ANY_MAGNET, MagnetUse, charge_field, check_magnet, coil_field
from haptorb.devices.placed_coils import (
    PlacedCoils,
    fill_points,
    find_farthest,
    find_overlap,
    measure_winding,
    place_coils,
)
from haptorb.devices.schema import list_limit_remarks
from haptorb.devices.uncertainty import ArrayUncertainty
from haptorb.display import format_quantity
from haptorb.errors import GeometryError
from haptorb.magnetics.dipole import MU0
from haptorb.magnetics.magnets import ChargedRing, CylinderMagnet, RingMagnet
from haptorb.magnetics.soft_sphere import (
    SoftSphere,
    response_to_source,
    weigh_charges,
)

__all__ = [
    "COIL_ARRAY",
    "ArrayMover",
    "BuildTolerance",
    "CoilArray",
    "MoverMagnet",
    "Surface",
    "array_geometry",
    "check_magnets",
    "check_places",
]


# --------------------------------------------------------------------------------------------------
# The record of coil arrays: a tool or plate with magnets in a hand, moved by the forces of coils that are anywhere.


COIL_ARRAY = DeviceKind(
    name="coil-array",
    title="coil array",
    world="wall",
)


# --------------------------------------------------------------------------------------------------
# The mover of a coil array: its magnets, sizes and places as people give them, and as compiled code takes them.


@final
@dataclass(frozen=True)
class MoverMagnet:
    """A round magnet, or a ring, in the mover."""

    position: Array  #: (3,) of its centre, mover frame [m]
    axis: Array  #: (3,) unit vector of its polarisation, mover frame
    outer_radius: float  #: [m]
    inner_radius: float  #: [m]
    length: float  #: [m]
    remanence: float  #: [T]
    use: MagnetUse = ANY_MAGNET  #: its grade and temperature

    @property
    def body(self) -> CylinderMagnet | RingMagnet:
        """The magnet in its own frame."""
        if self.inner_radius:
            return RingMagnet(self.outer_radius, self.inner_radius, self.length, self.remanence)
        return CylinderMagnet(self.outer_radius, self.length, self.remanence)

    @property
    def moment(self) -> float:
        """Magnetic moment [A·m²]: remanence times volume over μ0."""
        volume = np.pi * (self.outer_radius**2 - self.inner_radius**2) * self.length
        return float(self.remanence * volume / MU0)

    def charges(self, radial: int, azimuth: int) -> Array:
        """(4, n) places in the mover's frame [m] and charges [A·m]."""
        ring = ChargedRing(
            self.outer_radius, self.inner_radius, self.length, self.remanence, radial=radial, azimuth=azimuth
        )
        placed = rotation_to_axis(self.axis) @ ring.rows[:3] + self.position[:, None]
        return np.vstack([placed, ring.rows[3]])


@final
@dataclass(frozen=True)
class ArrayMover:
    """A tool or a plate with magnets; it touches the surface with its tip, at −z of the mover."""

    magnets: tuple[MoverMagnet, ...]
    tip_distance: float  #: from the mover's origin to the tip, along −z [m]
    mass: float  #: [kg]
    inertia: Array  #: (3,) principal moments about the mover's origin, mover frame [kg·m²]

    @property
    def moment(self) -> float:
        """Size of the magnets' moments together [A·m²]."""
        return float(np.linalg.norm(sum(magnet.moment * magnet.axis for magnet in self.magnets)))

    @property
    def reach(self) -> float:
        """Radius of a sphere about the mover's origin that holds all magnets [m]."""
        return max(
            float(np.linalg.norm(magnet.position) + np.hypot(magnet.outer_radius, 0.5 * magnet.length))
            for magnet in self.magnets
        )

    @cached_property
    def charge_map(self) -> tuple[Array, Array, Records, Array]:
        """charges (4, n), spans (g, rules + 1), (g,) MAGNET and core_charges (4, n'), as `ArrayMap` says."""
        parts, spans, places = [], [], []
        count = 0
        for magnet in self.magnets:
            row = [count]
            for radial, azimuth in RULES:
                parts.append(magnet.charges(radial, azimuth))
                count += parts[-1].shape[1]
                row.append(count)
            spans.append(row)
            places.append((magnet.position, 0.5 * magnet.length * magnet.axis, magnet.outer_radius))
        soft = np.hstack([magnet.charges(*RULES[CORE_RULE]) for magnet in self.magnets])
        return (
            np.ascontiguousarray(np.hstack(parts)),
            np.array(spans),
            np.array(places, MAGNET),
            np.ascontiguousarray(soft),
        )


_ORDERS = (4, 30)  #: fewest and most degrees of the core's harmonics
_LEFT_OUT = 1e-5  #: relative, of the core's series where charges are nearest
_REST_HEIGHT_M = 10e-3  #: a mover rests this far above contact [m]


@dataclass(frozen=True)
class Surface:
    """Contact surface of the tip: a dome about the origin, or a level plate."""

    dome_radius: float  #: [m]; 0: it is a plate
    height: float  #: of the plate over the origin [m]; of a dome 0
    thickness: float  #: height above contact up to which forces are rendered [m]
    half_angle: float  #: of a dome: maximum angle of the tool from the summit [rad]
    half_width: tuple[float, float]  #: of a plate: greatest |x| and |y| of the mover [m]
    contact: DomeContact
    wall: float = 0.0  #: thickness of a dome [m]

    @property
    def is_dome(self) -> bool:
        """Whether it is a dome, not a plate."""
        return self.dome_radius > 0.0


@dataclass(frozen=True)
class BuildTolerance:
    """Tolerances of the built coils: standard deviations from the values of the device file."""

    position: float = 0.0  #: along each axis [m]
    tilt: float = 0.0  #: about each axis across the coil's own [rad]
    strength: float = 0.0  #: relative, of the turns
    winding: float = 0.0  #: inner radius, outer radius and length of each coil [m]


@dataclass(frozen=True, kw_only=True)
class CoilArray(Device):
    """Any number of round coils anywhere, and a tool with one or several magnets on which they act.

    Built from a device file of the kind "coil-array". Parameters beside those of `haptorb.Device`:

    Parameters
    ----------
    windings : PlacedCoils
        Position [m], axis and winding of every coil.
    core : SoftSphere or None
        Soft-magnetic core at the origin.
    tool : ArrayMover
        Tool with its magnets.
    hand : Hand
        Simulated hand that holds the tool.
    surface : Surface
        Surface that the tool touches.
    tolerance : BuildTolerance
        Standard deviations of position [m], tilt [rad] and strength [1] of the simulated coils.
    thermometer_step : float
        Resolution of the thermometers [K].
    thermometer_noise : float
        Standard deviation of one temperature reading [K].
    uncertainty : ArrayUncertainty
        Standard uncertainties of the values, for the error budget.

    Notes
    -----
    Model "exact": the field of every thick winding at the charges of every magnet's faces, and the response of a soft
    core to both. Magnets and copper are rigid with relative permeability 1; eddy currents are left out.
    """

    kind: ClassVar[DeviceKind] = COIL_ARRAY

    windings: PlacedCoils
    core: SoftSphere | None
    tool: ArrayMover
    hand: Hand
    surface: Surface
    tolerance: BuildTolerance
    thermometer_step: float
    thermometer_noise: float
    uncertainty: ArrayUncertainty = field(default_factory=lambda: ArrayUncertainty.model_validate({}))

    models: tuple[str, ...] = ("exact",)

    @property
    def contact_height(self) -> float:
        """z of the mover's origin when an upright tool touches the surface at its middle [m]."""
        return (self.surface.dome_radius or self.surface.height) + self.tool.tip_distance

    @property
    def shell(self) -> Shell | None:
        """Workspace of the tool above a dome; None above a plate."""
        if not self.surface.is_dome:
            return None
        return Shell(self.contact_height, self.surface.thickness, self.tool.moment, self.surface.dome_radius)

    @property
    def is_upright(self) -> bool:
        """Over a plate; over a dome the tool is radial."""
        return not self.surface.is_dome

    @property
    def rest_position(self) -> Array:
        """(3,) 10 mm above contact in the middle [m]."""
        return np.array([0.0, 0.0, self.contact_height + _REST_HEIGHT_M])

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on inconsistent values of this device, which prevent no computation."""
        return tuple(list_limit_remarks(self.coils, self.supply, self.limits, *self.greatest_wrench))

    @property
    def greatest_wrench(self) -> tuple[float, float]:
        """Maximum force [N] and torque [N·m] on an upright tool in contact at the centre, all coils at full current.

        By point dipoles whose parts all add: an upper estimate, for checks of limits only.
        """
        coils, at = self.windings, np.array([0.0, 0.0, self.contact_height])
        area = np.pi * (coils.outer_radius**2 + coils.outer_radius * coils.inner_radius + coils.inner_radius**2) / 3
        moments = coils.turns * area * self.driven_current
        moment = sum(magnet.moment for magnet in self.tool.magnets)
        away = np.maximum(np.linalg.norm(coils.position - at, axis=1), 0.5 * coils.length)
        core = 1.0 if self.core is None else 3.0
        torque = core * MU0 * moment * moments / (2 * np.pi * away**3)
        return float((3 * torque / away).sum()), float(torque.sum())

    @property
    def build_checks(self) -> tuple[BuildCheck, ...]:
        """Buildability checks of this device: the wire in each winding, and space for windings and tool."""
        return (
            *super().build_checks,
            *self.windings.check_wires(self.coils, self.uncertainty.resistance),
            *check_places(self),
            *check_magnets(self),
        )

    def geometry(self) -> Geometry:
        """The parts of the device, its tool in contact."""
        return array_geometry(self)

    def wrench_map(self, state: State, model: str) -> WrenchMap:
        """(6, m) per ampere and (6,) passive, torque about the mover's origin; GeometryError in a coil or the core."""
        self.check_model(model)
        matrix, passive, pose = np.empty((6, self.channels)), np.empty(6), np.empty((4, 3))
        pose[:3], pose[3] = state.R_SR, state.p
        status = array_wrench(self.magnetics, pose, matrix, passive)
        if status != FREE:
            where = "the core" if status == IN_CORE else "a coil"
            x, y, z = (1e3 * state.p).tolist()
            raise GeometryError(
                f"device '{self.name}': with the mover at ({x:.1f}, {y:.1f}, {z:.1f}) mm a magnet would be inside "
                f"{where}; an upright tool touches at z = {self.contact_height * 1e3:.1f} mm"
            )
        return WrenchMap(matrix, passive, self.coils.names)

    @cached_property
    def magnetics(self) -> ArrayMap:
        """Coils, core and magnets as compiled code takes them: half a second for each sort of winding, once."""
        return self.compute_magnetics(self.windings)

    def compute_magnetics(self, windings: PlacedCoils) -> ArrayMap:
        """`magnetics` with coils elsewhere: `windings` of the same sizes, as they may really be built."""
        charges, spans, magnets, soft = self.tool.charge_map
        order, radius, responses, shares = 1, 0.0, np.zeros((self.channels, 3, 2)), np.zeros(3)
        if self.core is not None:
            order, radius = self._order(self.core), self.core.radius
            shares = weigh_charges(self.core, order)
            responses = np.stack([response_to_source(self.core, placed, order) for placed in place_coils(windings)])
        return ArrayMap(
            windings.placed, *windings.tables, charges, spans, magnets, soft, radius, order, responses, shares
        )

    def _order(self, core: SoftSphere) -> int:
        """Degrees of the core's harmonics, so that little is left out for magnets at the surface."""
        nearest = max(self.surface.dome_radius or self.surface.height, 1.05 * core.radius)
        share = core.radius**2 / (nearest * max(float(self.windings.nearest.min()), core.radius))
        return int(np.clip(np.ceil(np.log(_LEFT_OUT) / np.log(share)), *_ORDERS))

    def _list_facts(self) -> list[tuple[str, str]]:
        surface, tool = self.surface, self.tool
        over = (
            f"over a dome of {format_quantity(surface.dome_radius, 'm')}" if surface.is_dome
            else f"over a plate at {format_quantity(surface.height, 'm')}"
        )  # fmt: skip
        head, tail = Device._list_facts(self)[:2], Device._list_facts(self)[2:]
        core = "none" if self.core is None else f"a soft sphere of {format_quantity(self.core.radius, 'm')}"
        return [
            *head,
            ("workspace", f"{over}, rendered {format_quantity(surface.thickness, 'm')} above contact"),
            ("core", core),
            ("tool", f"{len(tool.magnets)} magnets, {format_quantity(tool.moment, 'A·m²')}, {1e3 * tool.mass:.3g} g"),
            *tail,
            *(("remark", remark) for remark in self.remarks),
        ]


# --------------------------------------------------------------------------------------------------
# The bodies of a coil array: coils, core, dome, and the tool in contact.


_SIZES = ("windings", "core.radius", "dome.radius", "plate.height", "tool.magnets", "tool.tip_distance")


def array_geometry(device: CoilArray) -> Geometry:
    """The parts of `device`, its tool upright and in contact in the middle."""
    coils, tool, surface = device.windings, device.tool, device.surface
    origin = np.array([0.0, 0.0, device.contact_height])
    windings = [
        RoundPart(
            name, "coil", coils.position[k], coils.axis[k], float(coils.inner_radius[k]), float(coils.outer_radius[k]),
            float(coils.length[k]), channel=name,
        )
        for k, name in enumerate(device.coils.names)
    ]  # fmt: skip
    magnets = [
        RoundPart(
            f"magnet {number}", "magnet", origin + magnet.position, magnet.axis, magnet.inner_radius,
            magnet.outer_radius, magnet.length, polarity=1.0, moves=True,
        )
        for number, magnet in enumerate(tool.magnets, 1)
    ]  # fmt: skip
    balls = [] if device.core is None else [Ball("core", "core", device.core.radius)]
    notes = ["not stated in the device file: the handle around the tool's magnets"]
    reach = None
    if surface.is_dome:
        inside = surface.dome_radius - surface.wall if surface.wall else 0.0
        balls.append(Ball("dome", "dome", surface.dome_radius, inside))
        contact = device.contact_height
        reach = Reach("tool", surface.half_angle, contact, contact + surface.thickness)
    else:
        notes.append(f"not drawn: the plate at {surface.height * 1e3:g} mm that the tool touches")
    return Geometry(
        round_parts=(*windings, *magnets),
        balls=tuple(balls),
        rods=(Rod("tool axis", origin - np.array([0.0, 0.0, tool.tip_distance]), origin),),
        reach=reach,
        notes=(*notes, *list_assumed(device.assumed, _SIZES)),
    )


# --------------------------------------------------------------------------------------------------
# Room for the parts of a coil array: windings beside each other and the core, below the surface, and the tool's magnets
# above it.


def check_places(device: CoilArray) -> list[BuildCheck]:
    """Whether the parts of `device` have room; its tool upright and in contact in the middle."""
    coils, surface, tool, names = device.windings, device.surface, device.tool, device.coils.names
    found = []
    if device.core is not None:
        nearest = int(np.argmin(coils.nearest))
        found.append(
            BuildCheck(
                "windings outside the core", f"coil {names[nearest]}, nearest to the origin",
                float(coils.nearest[nearest]), device.core.radius, "m",
                "move the winding out, or reduce core.radius", at_least=True,
            )
        )  # fmt: skip
    if len(names) > 1:
        gap, i, j = find_overlap(coils)
        found.append(
            BuildCheck(
                "windings beside each other", f"coils {names[i]} and {names[j]}, gap between them", gap, 0.0, "m",
                "move them apart, or make them smaller", at_least=True, note="negative: they overlap",
            )
        )  # fmt: skip
    lowest = max(-float(magnet.charges(2, 32)[2].min()) for magnet in tool.magnets)
    found.append(
        BuildCheck(
            "magnets above the tool's tip", "tool.tip_distance", tool.tip_distance, lowest, "m",
            "increase it, or move the magnets up: they would go into the surface before the tip", at_least=True,
        )
    )  # fmt: skip
    if surface.is_dome:
        far, free = find_farthest(coils), surface.dome_radius - surface.wall
        worst = int(np.argmax(far))
        found.append(
            BuildCheck(
                "windings inside the dome", f"coil {names[worst]}, farthest from the origin", float(far[worst]), free,
                "m", "move the winding in, or increase dome.radius or reduce dome.wall",
            )
        )  # fmt: skip
        if device.core is not None:
            found.append(
                BuildCheck(
                    "core inside the dome", "core.radius", device.core.radius, free, "m",
                    "reduce it, or increase dome.radius or reduce dome.wall",
                )
            )  # fmt: skip
    else:
        upright = np.abs(coils.axis[:, 2])
        top = coils.position[:, 2] + upright * coils.length / 2
        top += np.sqrt(np.maximum(1 - upright**2, 0.0)) * coils.outer_radius
        worst = int(np.argmax(top))
        found.append(
            BuildCheck(
                "windings below the plate", f"coil {names[worst]}, its highest point", float(top[worst]),
                surface.height, "m", "move the winding down, or increase plate.height", note="height over the origin",
            )
        )  # fmt: skip
    found.append(_check_tool(device))
    return found


def _check_tool(device: CoilArray) -> BuildCheck:
    """Distance of the magnets' faces and sides from a winding; its hole counts as free space."""
    coils, least, part = device.windings, np.inf, ""
    contact = np.array([0.0, 0.0, device.contact_height])
    for number, magnet in enumerate(device.tool.magnets, 1):
        size = PlacedCoils(
            (contact + magnet.position)[None], magnet.axis[None], np.ones(1), np.array([magnet.inner_radius]),
            np.array([magnet.outer_radius]), np.array([magnet.length]),
        )  # fmt: skip
        points = fill_points(size, 0)
        for k, name in enumerate(device.coils.names):
            apart = float(measure_winding(coils, k, points).min())
            if apart < least:
                least, part = apart, f"tool.magnets.{number} and coil {name}"
    return BuildCheck(
        "tool clear of the coils", f"{part}, in contact in the middle", least, 0.0, "m", "move the coil or the magnet",
        at_least=True, note="negative: inside",
    )  # fmt: skip


_PLACES = 5  #: of the tool along each side of its workspace, where the coils' fields are taken


def check_magnets(device: CoilArray) -> list[BuildCheck]:
    """Whether the tool's magnets keep their polarization, over the workspace: in contact, upright over a plate, radial
    over a dome."""
    surface, magnets, found = device.surface, device.tool.magnets, []
    if surface.is_dome:
        radial = np.vstack([[0.0, 0.0, 1.0], cap_directions(surface.half_angle, _PLACES**2)])
        places, turns = device.contact_height * radial, np.stack([rotation_to_axis(one) for one in radial])
    else:
        x, y = (np.linspace(-half, half, _PLACES) for half in surface.half_width)
        places = np.array([[a, b, device.contact_height] for a in x for b in y])
        turns = np.broadcast_to(np.eye(3), (len(places), 3, 3))
    windings = device.windings
    for number, magnet in enumerate(magnets, 1):
        own = rotation_to_axis(magnet.axis)
        low = magnet.position - np.sign(magnet.axis[2] or 1.0) * 0.5 * magnet.length * magnet.axis
        at = places + turns @ low
        axis = turns @ magnet.axis
        driven = np.empty((device.channels, len(at)))
        for k, (place, along) in enumerate(zip(windings.position, windings.axis, strict=True)):
            frame = rotation_to_axis(along)
            driven[k] = np.abs((coil_field(windings.coil(k), (at - place) @ frame) @ frame.T * axis).sum(axis=1))
        aside = 0.8 * magnet.outer_radius
        near = np.array([[0.0, 0, 0], [aside, 0, 0], [-aside, 0, 0], [0, aside, 0], [0, -aside, 0]]) @ own.T
        beside = np.zeros(len(near))
        for other in magnets:
            if other is not magnet:
                beside -= charge_field(other.charges(3, 16), magnet.position + near) @ magnet.axis
        found += check_magnet(
            f"tool.magnets.{number}", "remanence", magnet.body, magnet.use, device.coils.heat.stop,
            float(beside.max()), float((device.driven_current @ driven).max()),
        )  # fmt: skip
    return found
