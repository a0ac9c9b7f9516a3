"""Schema of the file of a spherical electromagnet, in addition to the sections of every device file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt, Len
from pydantic import Field, model_validator

from haptorb.devices import quantity as q
from haptorb.devices import schema as m
from haptorb.devices.build_checks import refuse_unbuildable
from haptorb.devices.core_parameters import CoreDynamics
from haptorb.devices.electromagnet import (
    CORE_SATURATION,
    DomeContact,
    Hand,
    SphericalElectromagnet,
    Tool,
    list_geometry_mistakes,
)
from haptorb.devices.electromagnet_wrench_map import Windings
from haptorb.devices.field_sensors import FieldSensors
from haptorb.devices.magnet_grades import Letters, MagnetUse, Temperature
from haptorb.devices.schema import (
    RIGHT_ANGLE,
    BasedOn,
    CommonFile,
    Drop,
    FieldSensorsSection,
    Positive,
    Section,
    ThermalSection,
    ThermometerSection,
    check_wall,
    limit_currents,
    list_limit_mistakes,
)
from haptorb.devices.touch_points import MarksSection
from haptorb.devices.uncertainty import ElectromagnetTolerance, ToolUncertainty
from haptorb.errors import DeviceError
from haptorb.magnetics.soft_sphere import SoftSphere
from haptorb.magnetics.wire import overall_diameter, wind

__all__ = ["ElectromagnetFile", "WindingsSection"]


# --------------------------------------------------------------------------------------------------
# What the file of a spherical electromagnet may say of its windings.


_MOST_FILL = 0.9  #: round wires side by side fill 0.907


class WindingsSection(Section):
    """[windings]"""

    turns: Annotated[
        tuple[Annotated[q.Number, Positive], ...], Len(3, 3), m.Meaning("turns of the coils about x, y and z")
    ]
    inner_radius: Annotated[
        tuple[Annotated[q.Length, Positive], ...],
        Len(3, 3),
        m.Meaning("inner radius of each winding"),
        m.Form("above core_radius"),
    ]
    outer_radius: Annotated[
        Annotated[tuple[Annotated[q.Length, Positive], ...], Len(3, 3)] | None,
        m.Meaning("outer radius of each winding"),
        m.Form("between inner_radius and dome.radius"),
        m.Without("as many layers of wire as turns and length need"),
    ] = None
    length: Annotated[
        tuple[Annotated[q.Length, Positive], ...], Len(3, 3), m.Meaning("length of each winding along its own axis")
    ]
    wire: Annotated[
        Annotated[tuple[Annotated[q.Length, Positive], ...], Len(3, 3)] | None,
        m.Meaning("diameter of each winding's wire, without enamel; the wire's resistance must be coils.resistance"),
        m.Without("that with which the winding has coils.resistance"),
    ] = None
    wire_overall: Annotated[
        Annotated[tuple[Annotated[q.Length, Positive], ...], Len(3, 3)] | None,
        m.Meaning("greatest diameter of each winding's wire over its enamel"),
        m.Form("above wire"),
        m.Without("of a wire with enamel of grade 1 by IEC 60317-0-1"),
    ] = None
    fill: Annotated[
        q.Number | None,
        Field(gt=0, le=_MOST_FILL),
        m.Meaning(
            "fill factor of copper in the windings' cross-section; if given, the windings determine the moments, and "
            "what the file does not state of resistances, inductances and heat capacity"
        ),
        m.Without("those of the file"),
    ] = None

    @model_validator(mode="after")
    def _check_wire(self) -> WindingsSection:
        if self.outer_radius is None and self.wire is None:
            raise ValueError("outer_radius is missing: give it, or wire to compute it from")
        if self.wire is not None and self.fill is not None:
            raise ValueError("has wire and fill: give the wire, or the share of the section that is copper, not both")
        if self.wire_overall is not None:
            if self.wire is None:
                raise ValueError("has wire_overall but no wire: give both, or neither")
            for bare, overall in zip(self.wire, self.wire_overall, strict=True):
                if overall <= bare:
                    raise ValueError(
                        f"wire_overall ({overall * 1e3:g} mm) must be greater than wire ({bare * 1e3:g} mm): it is the "
                        "diameter over the enamel"
                    )
        return self

    def build(self) -> Windings:
        """As the device has it; ValueError for wire that does not fit between the flanges."""
        wire = None if self.wire is None else np.array(self.wire)
        overall = None if self.wire_overall is None else np.array(self.wire_overall)
        turns, inner, length = (np.array(part) for part in (self.turns, self.inner_radius, self.length))
        if self.outer_radius is not None:
            return Windings(turns, inner, np.array(self.outer_radius), length, wire, overall, self.fill)
        assert self.wire is not None
        thick = np.array([overall_diameter(one) for one in self.wire]) if overall is None else overall
        outer = []
        for k, rows in enumerate(map(wind, turns.tolist(), inner.tolist(), length.tolist(), thick.tolist())):
            if rows is None:
                raise ValueError(
                    f"windings.length ({length[k] * 1e3:g} mm) is too short for a turn of {thick[k] * 1e3:.3g} mm wire"
                )
            outer.append(inner[k] + rows.depth)
        return Windings(turns, inner, np.array(outer), length, wire, overall)


Row3 = Annotated[tuple[q.MomentPerCurrent, ...], Len(3, 3)]


class ElectromagnetSection(Section):
    """[electromagnet]"""

    moment_per_current: Annotated[
        Annotated[tuple[Row3, ...], Len(3, 3)] | None,
        m.Meaning("magnetic moment (rows x, y, z) per ampere in each coil (columns), outside the dome"),
        m.Form("3 rows of 3, not singular"),
        m.Without("computed from [windings]"),
    ] = None
    moment_measured_at: Annotated[
        q.Length | None,
        Positive,
        m.Meaning("distance on a coil's axis at which its field was measured that moment_per_current stands for"),
        m.Form("at least dome.radius"),
        m.Without("far away: the moment of the whole coil with its core"),
    ] = None
    core_radius: Annotated[q.Length, Positive, m.Meaning("radius of the soft-magnetic sphere inside the coils")]
    core_permeability: Annotated[q.Number, Gt(1), m.Meaning("relative permeability of the core; inf is allowed")]
    core_saturation: Annotated[
        q.Polarization | None,
        Positive,
        m.Meaning("flux density up to which the core's permeability holds"),
        m.Without("1.5 T, of low-carbon steel"),
    ] = None


class CoreDynamicsSection(Section):
    """[core_dynamics]"""

    eddy_share: Annotated[
        q.Number, Field(ge=0, lt=1), m.Meaning("share of the moment that eddy currents in the core delay")
    ]
    eddy_time: Annotated[q.Duration, Positive, m.Meaning("time constant of that delay")]
    remanent_moment: Annotated[
        q.MagneticMoment, Field(ge=0), m.Meaning("remanent moment of the core along an axis after a large current")
    ]
    reversing_moment: Annotated[
        q.MagneticMoment, Positive, m.Meaning("change of the moment that reduces the remanence from full to zero")
    ]
    spread: Annotated[
        q.Number,
        Field(ge=0, le=1),
        m.Meaning("relative standard deviation of share, time and remanent moment from device to device"),
    ]

    def build(self) -> CoreDynamics:
        """As the device has it."""
        return CoreDynamics(**self.model_dump())


class DomeSection(Section):
    """[dome]"""

    radius: Annotated[q.Length, Positive, m.Meaning("outer radius of the dome that the tool touches")]
    wall: Annotated[
        q.Length, Field(ge=0), m.Meaning("thickness of the dome's wall, inside which core and coils must fit")
    ] = 0.0
    shell_thickness: Annotated[q.Length, Positive, m.Meaning("height above contact up to which forces are rendered")]
    workspace_half_angle: Annotated[
        q.Angle, Field(gt=0, le=RIGHT_ANGLE), m.Meaning("maximum angle of the tool from the summit")
    ]
    stiffness: Annotated[q.Stiffness, Positive, m.Meaning("stiffness of the dome under the tool's tip")]
    damping: Annotated[q.Damping, Field(ge=0), m.Meaning("damping of that contact")]
    friction: Annotated[q.Number, Field(ge=0), m.Meaning("coefficient of friction between tip and dome")]


class ToolSection(Section):
    """[tool]"""

    outer_radius: Annotated[q.Length, Positive, m.Meaning("outer radius of the tool's ring magnet")]
    inner_radius: Annotated[
        q.Length, Field(ge=0), m.Meaning("radius of the ring's hole"), m.Form("≥ 0, below outer_radius")
    ]
    length: Annotated[q.Length, Positive, m.Meaning("length of the magnet along the tool's axis")]
    remanence: Annotated[q.Polarization, Positive, m.Meaning("remanence of the magnet, J = μ0 M at its working point")]
    tip_distance: Annotated[
        q.Length,
        Positive,
        m.Meaning("distance from the magnet's centre to the tool's tip"),
        m.Form("at least half of length"),
    ]
    mass: Annotated[q.Mass, Positive, m.Meaning("mass of the whole tool")]
    inertia: Annotated[
        tuple[Annotated[q.Inertia, Positive], ...],
        Len(3, 3),
        m.Meaning("principal moments of inertia about the magnet's centre: across, across, along the axis"),
    ]
    grade: Letters = None
    greatest_temperature: Temperature = None
    worn: Annotated[
        bool,
        Field(strict=True),
        m.Meaning("whether the magnet is worn on a fingertip instead of held in a pen; only for drawings and texts"),
    ] = False

    @model_validator(mode="after")
    def _ring(self) -> ToolSection:
        check_wall(self.inner_radius, self.outer_radius)
        if self.tip_distance < self.length / 2:
            raise ValueError(f"tip_distance must be at least half the magnet's length ({self.length * 500:g} mm)")
        return self


class HandSection(Section):
    """[hand]"""

    mass: Annotated[q.Mass, Field(ge=0), m.Meaning("mass that the hand adds to the tool, for the simulation")]
    damping: Annotated[q.Damping, Positive, m.Meaning("damping of the grip along each axis")]
    stiffness: Annotated[q.Stiffness, Positive, m.Meaning("stiffness of the grip along each axis")]
    turn_damping: Annotated[q.TurnDamping, Positive, m.Meaning("damping of the grip against rotation")]
    turn_stiffness: Annotated[q.TurnStiffness, Positive, m.Meaning("stiffness of the grip against rotation")]


SENSOR_ERRORS = ("offset", "gain", "cross", "gain_drift", "offset_drift", "placement", "angle")


class ElectromagnetFile(CommonFile):
    """A file of kind "spherical-electromagnet"."""

    kind: Annotated[Literal["spherical-electromagnet"], m.Meaning("kind of device")]
    based_on: BasedOn = None
    drop: Drop = ()
    electromagnet: Annotated[ElectromagnetSection, m.Meaning("core, and moments of the coils")]
    dome: Annotated[DomeSection, m.Meaning("the dome over coils and core, and the space where forces are rendered")]
    tool: Annotated[ToolSection, m.Meaning("the stylus with its ring magnet")]
    hand: Annotated[HandSection, m.Meaning("the hand that holds the tool, for simulation and stability")]
    hall: Annotated[FieldSensorsSection, m.Meaning("field sensors of the stator")]
    thermometer: Annotated[ThermometerSection, m.Meaning("thermometers of the coils")]
    thermal: Annotated[
        ThermalSection | None,
        m.Meaning("the thermal model of all coils together"),
        m.Without("no thermal coupling, and exact values of coils.heat"),
    ] = None
    core_dynamics: Annotated[
        CoreDynamicsSection | None,
        m.Meaning("eddy currents and remanence of the core"),
        m.Without("no delay and no remanence"),
    ] = None
    windings: Annotated[
        WindingsSection | None,
        m.Meaning("sizes of the coils, one value per coil"),
        m.Without("none: moments are those of the file"),
    ] = None
    marks: Annotated[
        MarksSection | None,
        m.Meaning("points on the device for registering a tracker's frame"),
        m.Without("none: no `haptorb frame`"),
    ] = None
    tolerance: Annotated[
        ElectromagnetTolerance,
        m.Meaning("standard deviations of what is built from the file, for the simulation and the error budget"),
        m.Without("the defaults below"),
        Field(default_factory=ElectromagnetTolerance),
    ]
    uncertainty: Annotated[
        ToolUncertainty,
        m.Meaning("standard uncertainties of assumed or measured values, for `haptorb inspect --errors`"),
        m.Without("the defaults below"),
        Field(default_factory=ToolUncertainty),
    ]

    @model_validator(mode="after")
    def _check_sizes(self) -> ElectromagnetFile:
        if len(self.coils.names) != 3:
            raise ValueError(f"coils.names must be three for a spherical electromagnet; got {len(self.coils.names)}")
        if self.dome.radius <= self.electromagnet.core_radius:
            raise ValueError(
                f"dome.radius ({self.dome.radius * 1e3:g} mm) must be greater than electromagnet.core_radius "
                f"({self.electromagnet.core_radius * 1e3:g} mm)"
            )
        if self.dome.radius - self.dome.wall <= self.electromagnet.core_radius:
            raise ValueError(f"dome.wall ({self.dome.wall * 1e3:g} mm) reaches into the core; it must be thinner")
        sizes = self.windings
        if sizes is not None and sizes.outer_radius is not None:
            for inner, outer in zip(sizes.inner_radius, sizes.outer_radius, strict=True):
                check_wall(inner, outer)
        measured_at = self.electromagnet.moment_measured_at
        if measured_at is not None and measured_at < self.dome.radius:
            raise ValueError(
                f"electromagnet.moment_measured_at ({measured_at * 1e3:g} mm) is inside the dome "
                f"({self.dome.radius * 1e3:g} mm); it is the distance of the field sensor from the centre"
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

    def list_idle(self) -> Iterator[tuple[str, str]]:
        """Keys that change nothing, beside what else the file says, and why."""
        windings, moments = self.windings, self.electromagnet.moment_per_current
        if windings is not None and windings.fill is not None and moments is not None:
            yield "electromagnet.moment_per_current", "windings.fill gives the moments"
        if windings is not None and (moments is None or windings.fill is not None):
            yield (
                "uncertainty.moments",
                "the moments are computed from [windings], whose [tolerance] tells their errors",
            )
        if not self.hall.positions:
            for key in (
                "offset",
                "gain",
                "cross",
                "gain_drift",
                "offset_drift",
                "placement",
                "angle",
                "warming",
                "range",
            ):
                yield f"hall.{key}", "hall.positions has no field sensor"

    def build(self, assumed: dict[str, str], digest: str, *, override: bool = False) -> SphericalElectromagnet:
        """The device that this file describes; DeviceError with all mistakes.

        With `override` also one that cannot be built, for study.
        """
        device = self._build(assumed, digest)
        names, places = ((), np.empty((0, 3))) if device.marks is None else (device.marks.names, device.marks.positions)
        wrong = list_geometry_mistakes(device.core_radius, device.dome_radius, device.hall.positions, names, places)
        wrong += list_limit_mistakes(device.coils, device.supply, device.limits, *device.greatest_wrench)
        if wrong:
            raise DeviceError("\n".join(f"device '{self.name}': {line}" for line in wrong))
        if not override:
            refuse_unbuildable(self.name, device.build_checks)
        return device

    def _build(self, assumed: dict[str, str], digest: str) -> SphericalElectromagnet:
        dome, hall = self.dome, self.hall
        tool = self.tool.model_dump()
        tool["inertia"] = np.array(tool["inertia"])
        tool["use"] = MagnetUse(tool.pop("grade"), tool.pop("greatest_temperature"))
        given = self.electromagnet.moment_per_current
        windings = None if self.windings is None else self.windings.build()
        fill = None if self.windings is None else self.windings.fill
        core = SoftSphere(self.electromagnet.core_radius, self.electromagnet.core_permeability)
        measured_at = self.electromagnet.moment_measured_at or np.inf
        computed = windings is not None and (fill is not None or windings.wire is not None)
        common = self.common(computed=computed)
        coils = common["coils"]
        if windings is not None and computed:
            coils = windings.complete(coils, core, fill)
        if fill is not None:
            given = None
        if given is not None:
            moments = np.array(given)
        elif windings is not None:
            moments = windings.moment_per_current(core, measured_at)
        coils = limit_currents(coils, common["supply"])
        common["coils"] = coils
        if self.thermal is not None:
            common["coils"] = replace(coils, heat=self.thermal.complete(coils.heat, len(coils.names)))
        return SphericalElectromagnet(
            **common,
            assumed=assumed,
            digest=digest,
            moment_per_current=moments,
            moments_from="windings" if given is None else "device file",
            moments_at=measured_at,
            core_radius=self.electromagnet.core_radius,
            core_permeability=self.electromagnet.core_permeability,
            core_saturation=self.electromagnet.core_saturation or CORE_SATURATION,
            dome_radius=dome.radius,
            dome_wall=dome.wall,
            shell_thickness=dome.shell_thickness,
            workspace_half_angle=dome.workspace_half_angle,
            tool=Tool(**tool),
            hand=Hand(**self.hand.model_dump()),
            contact=DomeContact(dome.stiffness, dome.damping, dome.friction),
            hall=FieldSensors(
                np.array(hall.positions).reshape(-1, 3), hall.noise, hall.step, hall.errors(), hall.warming, hall.range
            ),
            core_dynamics=CoreDynamics() if self.core_dynamics is None else self.core_dynamics.build(),
            thermometer_step=self.thermometer.step,
            thermometer_noise=self.thermometer.noise,
            windings=windings,
            marks=None if self.marks is None else self.marks.build(),
            uncertainty=self.uncertainty,
            tolerance=self.tolerance,
        )
