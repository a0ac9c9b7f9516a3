"""A device of any number of round coils, an optional soft core, and a tool or plate with magnets in a hand."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np

from haptorb.devices.coil_array.array_wrench import FREE, IN_CORE, ArrayMap, array_wrench
from haptorb.devices.coil_array.kind import COIL_ARRAY
from haptorb.devices.coil_array.parts import ArrayMover, PlacedCoils
from haptorb.devices.device import Device, Shell
from haptorb.devices.electromagnet.electromagnet import DomeContact, Hand
from haptorb.devices.kind import DeviceKind
from haptorb.devices.schema.limit_checks import list_limit_remarks
from haptorb.devices.state import State, rotation_to_axis
from haptorb.devices.uncertainty.array import ArrayUncertainty
from haptorb.devices.wrench_map import WrenchMap
from haptorb.display.quantity_text import format_quantity
from haptorb.errors import GeometryError
from haptorb.numerics.arrays import Array
from haptorb.physics.fast_fields.sphere_answer import answer_to_source, weigh_charges
from haptorb.physics.sources.dipole import MU0
from haptorb.physics.sources.placement import PlacedSource
from haptorb.physics.sources.soft_sphere import SoftSphere

__all__ = ["BuildTolerance", "CoilArray", "Surface"]

_ORDERS = (4, 30)  #: fewest and most degrees of the core's harmonics
_LEFT_OUT = 1e-5  #: relative, of the core's series where charges are nearest
_ABOVE = 10e-3  #: a mover rests this far above contact [m]


@dataclass(frozen=True)
class Surface:
    """What the tip touches: a dome about the origin, or a level plate."""

    dome_radius: float  #: [m]; 0: it is a plate
    height: float  #: of the plate over the origin [m]; of a dome 0
    thickness: float  #: height above contact up to which forces are rendered [m]
    half_angle: float  #: of a dome: maximum angle of the tool from the summit [rad]
    half_width: tuple[float, float]  #: of a plate: greatest |x| and |y| of the mover [m]
    contact: DomeContact

    @property
    def is_dome(self) -> bool:
        """Whether it is a dome, not a plate."""
        return self.dome_radius > 0.0


@dataclass(frozen=True)
class BuildTolerance:
    """How far the coils that are built may be from the device file: standard deviations."""

    position: float = 0.0  #: along each axis [m]
    tilt: float = 0.0  #: about each axis across the coil's own [rad]
    strength: float = 0.0  #: relative, of the turns


@dataclass(frozen=True, kw_only=True)
class CoilArray(Device):
    """Round coils with places, axes and windings of their own, and a mover whose magnets they act on.

    Model "exact": the field of every thick winding on the charges of every magnet's faces, with the answer of a soft
    core to both. The magnets and the coils' copper are rigid, their permeability is 1; eddy currents are left out.
    """

    kind: ClassVar[DeviceKind] = COIL_ARRAY

    windings: PlacedCoils
    core: SoftSphere | None
    tool: ArrayMover
    hand: Hand
    surface: Surface
    tolerance: BuildTolerance
    thermometer_step: float  #: [K]
    thermometer_noise: float  #: [K]
    uncertainty: ArrayUncertainty = field(default_factory=lambda: ArrayUncertainty.model_validate({}))

    models: tuple[str, ...] = ("exact",)

    @property
    def contact_height(self) -> float:
        """z of the mover's origin when an upright tool touches the surface at its middle [m]."""
        return (self.surface.dome_radius or self.surface.height) + self.tool.tip_distance

    @property
    def shell(self) -> Shell | None:
        """Where the tool can be over a dome; None over a plate."""
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
        return np.array([0.0, 0.0, self.contact_height + _ABOVE])

    @property
    def remarks(self) -> tuple[str, ...]:
        """What should be known of this device though it can be computed with."""
        return tuple(list_limit_remarks(self.coils, self.supply, self.limits, *self.greatest_wrench))

    @property
    def greatest_wrench(self) -> tuple[float, float]:
        """Greatest force [N] and torque [N·m] on an upright tool in contact in the middle, all coils at full current.

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
        return WrenchMap(matrix, passive)

    @cached_property
    def magnetics(self) -> ArrayMap:
        """Coils, core and magnets as compiled code takes them: half a second for each sort of winding, once."""
        return self.compute_magnetics(self.windings)

    def compute_magnetics(self, windings: PlacedCoils) -> ArrayMap:
        """`magnetics` with coils elsewhere: `windings` of the same sizes, as they may really be built."""
        charges, spans, magnets, soft = self.tool.charge_map
        order, radius, answers, shares = 1, 0.0, np.zeros((self.channels, 3, 2)), np.zeros(3)
        if self.core is not None:
            order, radius = self._order(self.core), self.core.radius
            shares = weigh_charges(self.core, order)
            answers = np.stack([answer_to_source(self.core, placed, order) for placed in place_coils(windings)])
        return ArrayMap(
            windings.placed, *windings.tables, charges, spans, magnets, soft, radius, order, answers, shares
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


def place_coils(windings: PlacedCoils) -> list[PlacedSource]:
    """Every coil of `windings` where it is, in the stator frame, per ampere."""
    return [
        PlacedSource(windings.coil(number), windings.position[number], rotation_to_axis(windings.axis[number]))
        for number in range(len(windings.position))
    ]
