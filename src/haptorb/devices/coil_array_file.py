"""What the file of a coil array may say beside the sections that every device file has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len
from pydantic import Field, model_validator

from haptorb.arrays import Array
from haptorb.devices import quantity as q
from haptorb.devices import schema as m
from haptorb.devices.base import rotation_to_axis
from haptorb.devices.build_checks import refuse_unbuildable
from haptorb.devices.coil_array import ArrayMover, BuildTolerance, CoilArray, MoverMagnet, PlacedCoils, Surface
from haptorb.devices.electromagnet import DomeContact, Hand
from haptorb.devices.electromagnet_file import DomeSection, HandSection
from haptorb.devices.schema import (
    BasedOn,
    CommonFile,
    Drop,
    Point,
    Positive,
    Section,
    ThermometerSection,
    check_wall,
    limit_currents,
    list_limit_mistakes,
)
from haptorb.devices.uncertainty import ArrayUncertainty
from haptorb.errors import DeviceError
from haptorb.magnetics.soft_sphere import SoftSphere

__all__ = ["CoilArrayFile", "list_array_mistakes"]


# --------------------------------------------------------------------------------------------------
# Places of a coil array's file that cannot be, although every value by itself is well-formed.


_TOUCH = 1e-6  #: parts that touch do not overlap [m]
_STEPS = 48  #: points around a winding that are held against another one
_NAMED = 6  #: coils that one message names


def list_array_mistakes(
    names: Sequence[str], coils: PlacedCoils, tool: ArrayMover, core_radius: float, dome_radius: float, height: float
) -> list[str]:
    """Sentences; none is a pass. core_radius 0: no core; dome_radius 0: a plate at `height` [m].

    The mover is upright in the middle, 10 mm above contact.
    """
    found = []
    inside = [name for name, reach in zip(names, coils.nearest, strict=True) if reach < core_radius - _TOUCH]
    if inside:
        found.append(
            f"windings of coil {_join(inside)} reach into the core of {core_radius * 1e3:g} mm; move them out, or make "
            "the core smaller"
        )
    pairs = _list_overlaps(coils)
    if pairs:
        joined = [f"{names[i]} and {names[j]}" for i, j in pairs]
        found.append(f"windings of coils {_join(joined)} overlap; move them apart, or make them smaller")
    points = [_surface(coils, number) for number in range(len(names))]
    if dome_radius:
        far = [float(np.linalg.norm(at, axis=1).max()) for at in points]
        out = [name for name, reach in zip(names, far, strict=True) if reach > dome_radius]
        if out:
            found.append(
                f"windings of coil {_join(out)} reach out of the dome of {dome_radius * 1e3:g} mm, where the tool "
                "goes; move them in, or make the dome larger"
            )
    else:
        out = [name for name, at in zip(names, points, strict=True) if at[:, 2].max() > height + _TOUCH]
        if out:
            found.append(
                f"windings of coil {_join(out)} reach through the plate at {height * 1e3:g} mm, where the tool goes; "
                "move them down, or the plate up"
            )
    lowest = max(-float(magnet.charges(2, 32)[2].min()) for magnet in tool.magnets)
    if lowest > tool.tip_distance + _TOUCH:
        found.append(
            f"tool.tip_distance is {tool.tip_distance * 1e3:g} mm, but a magnet reaches {lowest * 1e3:.3g} mm below "
            "the tool's origin: it would go into the surface before the tip; give at least that"
        )
    rest = np.array([0.0, 0.0, (dome_radius or height) + tool.tip_distance + 10e-3])
    for number, magnet in enumerate(tool.magnets, 1):
        at = magnet.charges(5, 32)[:3].T + rest
        hit = [name for k, name in enumerate(names) if _contains(coils, k, at).any()]
        if hit:
            found.append(
                f"tool.magnets.{number} is inside coil {_join(hit)} when the tool rests 10 mm above contact; move the "
                "coil or the magnet"
            )
    return found


def _join(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more


def _surface(coils: PlacedCoils, number: int) -> Array:
    """(n, 3) points in and on winding `number`, a hair inside its faces, stator frame [m]."""
    angle = 2 * np.pi * np.arange(_STEPS) / _STEPS
    inner, outer = float(coils.inner_radius[number]) + _TOUCH, float(coils.outer_radius[number]) - _TOUCH
    half = 0.5 * float(coils.length[number]) - _TOUCH
    rho, z, phi = np.meshgrid(np.linspace(inner, outer, 5), np.linspace(-half, half, 7), angle)
    own = np.stack([rho * np.cos(phi), rho * np.sin(phi), z], axis=-1).reshape(-1, 3)
    placed: Array = own @ rotation_to_axis(coils.axis[number]).T + coils.position[number]
    return placed


def _contains(coils: PlacedCoils, number: int, points: Array) -> Array:
    away = points - coils.position[number]
    along = away @ coils.axis[number]
    across = np.sqrt(np.maximum((away**2).sum(axis=1) - along**2, 0.0))
    inside: Array = (
        (across > coils.inner_radius[number]) & (across < coils.outer_radius[number])
        & (np.abs(along) < coils.length[number] / 2)
    )  # fmt: skip
    return inside


def _list_overlaps(coils: PlacedCoils) -> list[tuple[int, int]]:
    """Pairs of windings that share a place, by points a hair inside the one that are inside the other."""
    reach = np.hypot(coils.outer_radius, coils.length / 2)
    apart = np.linalg.norm(coils.position[:, None] - coils.position[None, :], axis=-1)
    near = np.argwhere(np.triu(apart < reach[:, None] + reach[None, :], 1))
    found = []
    for i, j in near.tolist():
        if _contains(coils, j, _surface(coils, i)).any() or _contains(coils, i, _surface(coils, j)).any():
            found.append((i, j))
    return found


_MOST_COILS, _MOST_MAGNETS = 100, 16
_MOST_FILL = 0.9  #: round wires side by side fill 0.907
_EACH = m.Form("one value for all coils, or one per name in coils.names")
Direction = Annotated[tuple[Annotated[q.Number, Ge(-1e3), Le(1e3)], ...], Len(3, 3)]


def _unit(direction: tuple[float, ...], key: str) -> Array:
    """(3,) `direction` at length 1; ValueError, which names `key`, for the zero vector."""
    vector = np.array(direction, dtype=np.float64)
    length = float(np.linalg.norm(vector))
    if not length > 1e-9:
        raise ValueError(f"{key} must be a direction, not the zero vector; got {list(direction)}")
    unit: Array = vector / length
    return unit


class PlacedCoilsSection(Section):
    """[windings]"""

    position: Annotated[
        tuple[Point, ...],
        Len(1, _MOST_COILS),
        m.Meaning("centre of each winding, stator frame"),
        m.Form("one position per name in coils.names"),
    ]
    axis: Annotated[
        tuple[Direction, ...],
        Len(1, _MOST_COILS),
        m.Meaning("direction about which a positive current is right-handed, of any length"),
        m.Form("one direction for all coils, or one per name in coils.names"),
    ]
    turns: Annotated[
        tuple[Annotated[q.Number, Gt(0), Le(1e6)], ...], Len(1, _MOST_COILS), m.Meaning("turns of each coil"), _EACH
    ]
    inner_radius: Annotated[
        tuple[Annotated[q.Length, Positive], ...], Len(1, _MOST_COILS), m.Meaning("inner radius of each winding"), _EACH
    ]
    outer_radius: Annotated[
        tuple[Annotated[q.Length, Positive], ...], Len(1, _MOST_COILS), m.Meaning("outer radius of each winding"), _EACH
    ]
    length: Annotated[
        tuple[Annotated[q.Length, Positive], ...], Len(1, _MOST_COILS),
        m.Meaning("length of each winding along its axis"), _EACH,
    ]  # fmt: skip
    fill: Annotated[
        q.Number | None,
        Field(gt=0, le=_MOST_FILL),
        m.Meaning(
            "fill factor of copper in the windings' cross-section; if given, the windings instead of the file "
            "determine "
            "resistances, inductances and the windings' heat capacity"
        ),
        m.Without("those of the file"),
    ] = None

    def build(self, count: int) -> PlacedCoils:
        """As the device has it, for `count` coils; ValueError where other numbers of values are given."""
        columns = {}
        for key in ("position", "axis", "turns", "inner_radius", "outer_radius", "length"):
            values = getattr(self, key)
            if len(values) not in ((count,) if key == "position" else (1, count)):
                one = "" if key == "position" else "one value for all, or "
                raise ValueError(
                    f"windings.{key} has {len(values)} values, but coils.names has {count}; give {one}{count}"
                )
            columns[key] = values * (count // len(values))
        for inner, outer in zip(columns["inner_radius"], columns["outer_radius"], strict=True):
            check_wall(inner, outer)
        axes = np.array([_unit(axis, "windings.axis") for axis in columns.pop("axis")])
        return PlacedCoils(axis=axes, **{key: np.array(values, dtype=np.float64) for key, values in columns.items()})


class SoftCoreSection(Section):
    """[core]"""

    radius: Annotated[q.Length, Positive, m.Meaning("radius of the soft-magnetic sphere about the origin")]
    permeability: Annotated[q.Number, Gt(1), m.Meaning("relative permeability of the core; inf is allowed")]


class PlateSection(Section):
    """[plate]"""

    height: Annotated[q.Length, Positive, m.Meaning("height of the level plate over the origin")]
    half_width: Annotated[
        tuple[Annotated[q.Length, Positive], ...],
        Len(2, 2),
        m.Meaning("maximum distance of the tool from the origin along x and along y"),
    ]
    thickness: Annotated[q.Length, Positive, m.Meaning("height above contact up to which forces are rendered")]
    stiffness: Annotated[q.Stiffness, Positive, m.Meaning("stiffness of the plate under the tool's tip")]
    damping: Annotated[q.Damping, Field(ge=0), m.Meaning("damping of that contact")]
    friction: Annotated[q.Number, Field(ge=0), m.Meaning("coefficient of friction between tip and plate")]


class MoverMagnetSection(Section):
    """[[tool.magnets]]"""

    position: Annotated[Point, m.Meaning("centre of the magnet from the tool's origin, tool's frame")]
    axis: Annotated[Direction, m.Meaning("direction of its polarisation in the tool's frame, of any length")]
    outer_radius: Annotated[q.Length, Positive, m.Meaning("outer radius of the magnet")]
    inner_radius: Annotated[
        q.Length, Field(ge=0), m.Meaning("radius of the hole of a ring"), m.Form("≥ 0, below outer_radius")
    ] = 0.0
    length: Annotated[q.Length, Positive, m.Meaning("length of the magnet along its axis")]
    remanence: Annotated[q.Polarization, Positive, m.Meaning("remanence of the magnet, J = μ0 M at its working point")]

    @model_validator(mode="after")
    def _check(self) -> MoverMagnetSection:
        check_wall(self.inner_radius, self.outer_radius)
        _unit(self.axis, "axis")
        return self

    def build(self) -> MoverMagnet:
        """As the device has it."""
        values = self.model_dump() | {"position": np.array(self.position), "axis": _unit(self.axis, "axis")}
        return MoverMagnet(**values)


class ArrayToolSection(Section):
    """[tool]"""

    tip_distance: Annotated[
        q.Length,
        Positive,
        m.Meaning("distance from the tool's origin down to its tip, along −z of the tool"),
        m.Form("at least down to the lowest part of the magnets"),
    ]
    mass: Annotated[q.Mass, Positive, m.Meaning("mass of the whole tool")]
    inertia: Annotated[
        tuple[Annotated[q.Inertia, Positive], ...],
        Len(3, 3),
        m.Meaning("principal moments of inertia about the tool's origin, along x, y and z of the tool"),
    ]
    magnets: Annotated[tuple[MoverMagnetSection, ...], Len(1, _MOST_MAGNETS), m.Meaning("the magnets in the tool")]

    def build(self) -> ArrayMover:
        """As the device has it."""
        magnets = tuple(magnet.build() for magnet in self.magnets)
        return ArrayMover(magnets, self.tip_distance, self.mass, np.array(self.inertia))


class ToleranceSection(Section):
    """[tolerance]"""

    position: Annotated[q.Length, Field(ge=0), m.Meaning("standard deviation of a coil's position along each axis")] = (
        0.0
    )
    tilt: Annotated[q.Angle, Field(ge=0, le=0.5), m.Meaning("standard deviation of a coil's axis")] = 0.0
    strength: Annotated[
        q.Number, Field(ge=0, le=0.5), m.Meaning("relative standard deviation of a coil's field per ampere")
    ] = 0.0

    def build(self) -> BuildTolerance:
        """As the device has it."""
        return BuildTolerance(**self.model_dump())


class CoilArrayFile(CommonFile):
    """A file of kind "coil-array"."""

    kind: Annotated[Literal["coil-array"], m.Meaning("kind of device")]
    based_on: BasedOn = None
    drop: Drop = ()
    windings: Annotated[PlacedCoilsSection, m.Meaning("position, axis and winding of every coil")]
    core: Annotated[
        SoftCoreSection | None, m.Meaning("a soft-magnetic sphere about the origin"), m.Without("no core")
    ] = None
    dome: Annotated[
        DomeSection | None,
        m.Meaning("a dome about the origin that the tool touches"),
        m.Without("none: give [plate]"),
    ] = None
    plate: Annotated[
        PlateSection | None, m.Meaning("a level plate that the tool touches"), m.Without("none: give [dome]")
    ] = None
    tool: Annotated[ArrayToolSection, m.Meaning("the tool or plate with magnets")]
    hand: Annotated[HandSection, m.Meaning("the hand that holds the tool, for simulation and stability")]
    thermometer: Annotated[ThermometerSection, m.Meaning("thermometers of the coils")]
    tolerance: Annotated[
        ToleranceSection,
        m.Meaning("manufacturing tolerances of the coils, for the simulation and the error budget"),
        m.Without("coils exactly as in the file"),
        Field(default_factory=ToleranceSection),
    ]
    uncertainty: Annotated[
        ArrayUncertainty,
        m.Meaning("standard uncertainties of assumed or measured values, for `haptorb inspect --errors`"),
        m.Without("the defaults below"),
        Field(default_factory=ArrayUncertainty),
    ]

    @model_validator(mode="after")
    def _check_surface(self) -> CoilArrayFile:
        if (self.dome is None) == (self.plate is None):
            raise ValueError("give either [dome] or [plate]: the surface that the tool touches")
        return self

    def build(self, assumed: dict[str, str], digest: str, *, override: bool = False) -> CoilArray:
        """The device that this file describes; DeviceError with everything that cannot be.

        With `override` parts may overlap, for study.
        """
        device = self._build(assumed, digest)
        surface, core = device.surface, 0.0 if device.core is None else device.core.radius
        wrong = list_array_mistakes(
            device.coils.names, device.windings, device.tool, core, surface.dome_radius, surface.height
        )
        if surface.is_dome and surface.dome_radius <= core:
            wrong.append(f"dome.radius ({surface.dome_radius * 1e3:g} mm) must be greater than core.radius")
        if not override:
            refuse_unbuildable(self.name, device.build_checks, wrong)
        wrong = list_limit_mistakes(device.coils, device.supply, device.limits, *device.greatest_wrench)
        if wrong:
            raise DeviceError("\n".join(f"device '{self.name}': {line}" for line in wrong))
        return device

    def _build(self, assumed: dict[str, str], digest: str) -> CoilArray:
        common = self.common(computed=self.windings.fill is not None)
        windings = self.windings.build(len(self.coils.names))
        core = None if self.core is None else SoftSphere(self.core.radius, self.core.permeability)
        if self.windings.fill is not None:
            common["coils"] = windings.complete(common["coils"], core, self.windings.fill)
        common["coils"] = limit_currents(common["coils"], common["supply"])
        return CoilArray(
            **common,
            assumed=assumed,
            digest=digest,
            windings=windings,
            core=core,
            tool=self.tool.build(),
            hand=Hand(**self.hand.model_dump()),
            surface=self._surface(),
            tolerance=self.tolerance.build(),
            uncertainty=self.uncertainty,
            thermometer_step=self.thermometer.step,
            thermometer_noise=self.thermometer.noise,
        )

    def _surface(self) -> Surface:
        if self.dome is not None:
            dome = self.dome
            contact = DomeContact(dome.stiffness, dome.damping, dome.friction)
            return Surface(dome.radius, 0.0, dome.shell_thickness, dome.workspace_half_angle, (0.0, 0.0), contact)
        plate = self.plate
        assert plate is not None
        contact = DomeContact(plate.stiffness, plate.damping, plate.friction)
        across = (plate.half_width[0], plate.half_width[1])
        return Surface(0.0, plate.height, plate.thickness, 0.0, across, contact)
