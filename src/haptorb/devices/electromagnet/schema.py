"""What the file of a spherical electromagnet may say beside the sections that every device file has."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt, Len
from pydantic import Field, model_validator

from haptorb.devices.electromagnet.electromagnet import DomeContact, Hand, SphericalElectromagnet, Tool
from haptorb.devices.electromagnet.touch_points import Marks
from haptorb.devices.electromagnet.windings import Windings
from haptorb.devices.field_sensors import FieldSensors
from haptorb.devices.schema import quantity as q
from haptorb.devices.schema.sections import (
    CommonFile,
    FieldSensorsSection,
    Name,
    Point,
    Positive,
    Section,
    ThermometerSection,
    check_wall,
)
from haptorb.physics.sources.soft_sphere import SoftSphere

__all__ = ["ElectromagnetFile"]

_SPREAD = 1e-3  #: marks nearer to a common line than this cannot hold a frame [m]
Row3 = Annotated[tuple[q.MomentPerCurrent, ...], Len(3, 3)]


class ElectromagnetSection(Section):
    """[electromagnet]"""

    moment_per_current: Annotated[tuple[Row3, ...], Len(3, 3)] | None = None
    core_radius: Annotated[q.Length, Positive]
    core_permeability: Annotated[q.Number, Gt(1)]


class DomeSection(Section):
    """[dome]"""

    radius: Annotated[q.Length, Positive]
    shell_thickness: Annotated[q.Length, Positive]
    workspace_half_angle: Annotated[q.Angle, Positive]
    stiffness: Annotated[q.Stiffness, Positive]
    damping: Annotated[q.Damping, Field(ge=0)]
    friction: Annotated[q.Number, Field(ge=0)]


class ToolSection(Section):
    """[tool]"""

    outer_radius: Annotated[q.Length, Positive]
    inner_radius: Annotated[q.Length, Field(ge=0)]
    length: Annotated[q.Length, Positive]
    remanence: Annotated[q.Polarization, Positive]
    tip_distance: Annotated[q.Length, Positive]
    mass: Annotated[q.Mass, Positive]
    inertia: Annotated[tuple[Annotated[q.Inertia, Positive], ...], Len(3, 3)]

    @model_validator(mode="after")
    def _ring(self) -> ToolSection:
        check_wall(self.inner_radius, self.outer_radius)
        if self.tip_distance < self.length / 2:
            raise ValueError(f"tip_distance must be at least half the magnet's length ({self.length * 500:g} mm)")
        return self


class HandSection(Section):
    """[hand]"""

    mass: Annotated[q.Mass, Field(ge=0)]
    damping: Annotated[q.Damping, Positive]
    stiffness: Annotated[q.Stiffness, Positive]
    turn_damping: Annotated[q.TurnDamping, Positive]
    turn_stiffness: Annotated[q.TurnStiffness, Positive]


class WindingsSection(Section):
    """[windings]"""

    turns: Annotated[tuple[Annotated[q.Number, Positive], ...], Len(3, 3)]
    inner_radius: Annotated[tuple[Annotated[q.Length, Positive], ...], Len(3, 3)]
    outer_radius: Annotated[tuple[Annotated[q.Length, Positive], ...], Len(3, 3)]
    length: Annotated[tuple[Annotated[q.Length, Positive], ...], Len(3, 3)]

    def build(self) -> Windings:
        """As the device has it."""
        return Windings(*(np.array(part) for part in (self.turns, self.inner_radius, self.outer_radius, self.length)))


class MarksSection(Section):
    """[marks]"""

    names: Annotated[tuple[Name, ...], Len(3, 100)]
    positions: Annotated[tuple[Point, ...], Len(3, 100)]

    @model_validator(mode="after")
    def _check_marks(self) -> MarksSection:
        if len(self.names) != len(self.positions):
            raise ValueError(f"has {len(self.names)} names but {len(self.positions)} positions")
        if len(set(self.names)) != len(self.names):
            raise ValueError("has a duplicate name")
        places = np.array(self.positions)
        spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if spread[1] < _SPREAD:
            raise ValueError("must not lie on one line: a frame could turn about it")
        return self

    def build(self) -> Marks:
        """As the device has it."""
        return Marks(self.names, np.array(self.positions))


class ElectromagnetFile(CommonFile):
    """A file of kind "spherical-electromagnet"."""

    kind: Literal["spherical-electromagnet"]
    based_on: str | None = None
    electromagnet: ElectromagnetSection
    dome: DomeSection
    tool: ToolSection
    hand: HandSection
    hall: FieldSensorsSection
    thermometer: ThermometerSection
    windings: WindingsSection | None = None
    marks: MarksSection | None = None

    @model_validator(mode="after")
    def _clear(self) -> ElectromagnetFile:
        if self.windings is None:
            return self
        core, dome = self.electromagnet.core_radius, self.dome.radius
        sizes = zip(self.coils.names, self.windings.inner_radius, self.windings.outer_radius, strict=True)
        for name, inner, outer in sizes:
            if not core < inner < outer < dome:
                raise ValueError(
                    f"windings of coil '{name}' reach from {inner * 1e3:g} to {outer * 1e3:g} mm; they must lie "
                    f"between the core ({core * 1e3:g} mm) and the dome ({dome * 1e3:g} mm), the inner radius first"
                )
        return self

    @model_validator(mode="after")
    def _check_sizes(self) -> ElectromagnetFile:
        if len(self.coils.names) != 3:
            raise ValueError(f"coils.names must be three for a spherical electromagnet; got {len(self.coils.names)}")
        if self.dome.radius <= self.electromagnet.core_radius:
            raise ValueError(
                f"dome.radius ({self.dome.radius * 1e3:g} mm) must be greater than electromagnet.core_radius "
                f"({self.electromagnet.core_radius * 1e3:g} mm)"
            )
        given = self.electromagnet.moment_per_current
        if given is None and self.windings is None:
            raise ValueError(
                "electromagnet.moment_per_current is missing: give the measured moment per ampere of each coil, or "
                "[windings] with turns, inner_radius, outer_radius and length to compute it from"
            )
        if given is not None and np.linalg.cond(np.array(given)) > 100:
            raise ValueError(
                "electromagnet.moment_per_current is (nearly) singular: the coils' moments are linearly dependent"
            )
        return self

    def build(self, assumed: dict[str, str], digest: str, *, override: bool = False) -> SphericalElectromagnet:
        """The device that this file describes; there are no findings to override beyond wrong values."""
        dome, hall = self.dome, self.hall
        tool = self.tool.model_dump()
        tool["inertia"] = np.array(tool["inertia"])
        given = self.electromagnet.moment_per_current
        windings = None if self.windings is None else self.windings.build()
        if given is not None:
            moments = np.array(given)
        elif windings is not None:
            core = SoftSphere(self.electromagnet.core_radius, self.electromagnet.core_permeability)
            moments = windings.moment_per_current(core)
        return SphericalElectromagnet(
            **self.common(),
            assumed=assumed,
            digest=digest,
            moment_per_current=moments,
            moments_from="windings" if given is None else "device file",
            core_radius=self.electromagnet.core_radius,
            core_permeability=self.electromagnet.core_permeability,
            dome_radius=dome.radius,
            shell_thickness=dome.shell_thickness,
            workspace_half_angle=dome.workspace_half_angle,
            tool=Tool(**tool),
            hand=Hand(**self.hand.model_dump()),
            contact=DomeContact(dome.stiffness, dome.damping, dome.friction),
            hall=FieldSensors(np.array(hall.positions).reshape(-1, 3), hall.noise, hall.step),
            thermometer_step=self.thermometer.step,
            thermometer_noise=self.thermometer.noise,
            windings=windings,
            marks=None if self.marks is None else self.marks.build(),
        )
