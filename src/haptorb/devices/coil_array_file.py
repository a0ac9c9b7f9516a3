"""Schema of the file of a coil array, in addition to the sections of every device file."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len
from pydantic import Field, model_validator

from haptorb.arrays import Array
from haptorb.devices import quantity as q
from haptorb.devices import schema as m
from haptorb.devices.build_checks import refuse_unbuildable
from haptorb.devices.coil_array import ArrayMover, BuildTolerance, CoilArray, MoverMagnet, Surface
from haptorb.devices.electromagnet import DomeContact, Hand
from haptorb.devices.electromagnet_file import DomeSection, HandSection
from haptorb.devices.magnet_grades import Letters, MagnetUse, Temperature
from haptorb.devices.placed_coils import PlacedCoils
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

__all__ = ["CoilArrayFile"]


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
            "fill factor of copper in the windings' cross-section; if given, the windings determine what the file does "
            "not state of resistances, inductances and heat capacity"
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
        sizes = {key: np.array(values, dtype=np.float64) for key, values in columns.items()}
        return PlacedCoils(axis=axes, **sizes, copper_share=self.fill)


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
    grade: Letters = None
    greatest_temperature: Temperature = None

    @model_validator(mode="after")
    def _check(self) -> MoverMagnetSection:
        check_wall(self.inner_radius, self.outer_radius)
        _unit(self.axis, "axis")
        return self

    def build(self) -> MoverMagnet:
        """As the device has it."""
        values = self.model_dump() | {"position": np.array(self.position), "axis": _unit(self.axis, "axis")}
        values["use"] = MagnetUse(values.pop("grade"), values.pop("greatest_temperature"))
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
        q.Number,
        Field(ge=0, le=0.5),
        m.Meaning("relative standard deviation of a coil's turns, and so of its field per ampere"),
    ] = 0.0
    winding: Annotated[
        q.Length,
        Field(ge=0, le=0.003),
        m.Meaning("standard deviation of a coil's inner radius, outer radius and length"),
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
        if not override:
            refuse_unbuildable(self.name, device.build_checks)
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
            return Surface(
                dome.radius, 0.0, dome.shell_thickness, dome.workspace_half_angle, (0.0, 0.0), contact, dome.wall
            )
        plate = self.plate
        assert plate is not None
        contact = DomeContact(plate.stiffness, plate.damping, plate.friction)
        across = (plate.half_width[0], plate.half_width[1])
        return Surface(0.0, plate.height, plate.thickness, 0.0, across, contact)
