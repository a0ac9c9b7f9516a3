"""A spherical electromagnet that pushes and pulls a magnet in a tool: Zárate 2020's Omni, and its relatives."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import product
from typing import ClassVar

import numpy as np
from numpy import ascontiguousarray

from haptorb.devices.device import Device, Shell
from haptorb.devices.electromagnet.core_dynamics import CoreDynamics
from haptorb.devices.electromagnet.kind import ELECTROMAGNET
from haptorb.devices.electromagnet.passive_pull import PassivePull
from haptorb.devices.electromagnet.remarks import list_remarks
from haptorb.devices.electromagnet.ring_tool import dipole_per_ampere, ring_per_ampere
from haptorb.devices.electromagnet.touch_points import Marks
from haptorb.devices.electromagnet.windings import Windings
from haptorb.devices.field_sensors import FieldSensors
from haptorb.devices.kind import DeviceKind
from haptorb.devices.schema.limit_checks import list_limit_remarks
from haptorb.devices.state import State
from haptorb.devices.uncertainty.tool import ToolUncertainty
from haptorb.devices.wrench_map import WrenchMap
from haptorb.display.quantity_text import format_quantity
from haptorb.errors import GeometryError
from haptorb.numerics.arrays import Array
from haptorb.physics.sources.charged_ring import ChargedRing
from haptorb.physics.sources.dipole import MU0
from haptorb.physics.sources.soft_sphere import SoftSphere

__all__ = ["DomeContact", "Hand", "SphericalElectromagnet", "Tool"]

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

    @property
    def moment(self) -> float:
        """Magnetic moment m_p [A·m²]: remanence times volume over μ0."""
        volume = np.pi * (self.outer_radius**2 - self.inner_radius**2) * self.length
        return float(self.remanence * volume / MU0)


@dataclass(frozen=True)
class Hand:
    """A hand as a mass on springs and dampers: what it adds to the tool, and how it holds it."""

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
    """Three coils about one soft sphere, and a magnet in a tool that moves over a dome.

    Models: "exact" has the tool's magnet at its size and the pull of the core on it; "published" is Zárate 2020's, two
    point dipoles. In both, the electromagnet is the point dipole that calibration measured outside the dome.
    """

    kind: ClassVar[DeviceKind] = ELECTROMAGNET

    moment_per_current: Array  #: (3, 3) [m²], m_e = moment_per_current @ currents
    core_radius: float  #: [m]
    core_permeability: float  #: relative, may be inf
    dome_radius: float  #: [m]
    shell_thickness: float  #: height above contact up to which forces are rendered [m]
    workspace_half_angle: float  #: [rad] from +z
    tool: Tool
    hand: Hand
    contact: DomeContact
    hall: FieldSensors
    thermometer_step: float  #: [K]
    thermometer_noise: float  #: [K]
    windings: Windings | None = None  #: the coils' sizes, where given or assumed
    moments_from: str = "device file"  #: where `moment_per_current` comes from: that, "windings" or "calibration"
    core_dynamics: CoreDynamics = field(default_factory=CoreDynamics)  #: eddy currents and remanence
    marks: Marks | None = None  #: places to touch with the tip, where there are any
    uncertainty: ToolUncertainty = field(
        default_factory=lambda: ToolUncertainty.model_validate({})
    )  #: how well the values are known

    models: tuple[str, ...] = ("exact", "published")

    @property
    def tick_models(self) -> tuple[str, ...]:
        """Both: each takes microseconds."""
        return self.models

    @property
    def contact_distance(self) -> float:
        """Distance of the tool's magnet from the centre when a radial tool touches the dome: d_min [m]."""
        return self.dome_radius + self.tool.tip_distance

    @property
    def shell(self) -> Shell:
        """Where the tool can be."""
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
        """What the core does to the tool's magnet by itself, erratum E18."""
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

    def predict_moments(self) -> Array | None:
        """(3, 3) [m²] m_e per ampere from the coils' sizes and the core, to be held against `moment_per_current`; None
        where the sizes are not known."""
        return None if self.windings is None else self.windings.moment_per_current(self.core)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What should be known of this device though it can be computed with."""
        moments = list_remarks(self.coils, self.core, self.windings, self.moment_per_current, self.moments_from)
        return (*moments, *list_limit_remarks(self.coils, self.supply, self.limits, *self.greatest_wrench))

    @property
    def greatest_wrench(self) -> tuple[float, float]:
        """Greatest force [N] and torque [N·m] on a radial tool that touches the summit, all coils at full current.

        By the published model, which takes the tool for a dipole: some 15 % below the exact one.
        """
        corners = np.array(list(product((-1.0, 1.0), repeat=self.channels))) * self.driven_current
        moments = corners @ self.moment_per_current.T
        scale = MU0 * self.tool.moment / (4 * np.pi * self.contact_distance**3)
        across, along = np.hypot(moments[:, 0], moments[:, 1]), moments[:, 2]
        force = 3 * scale / self.contact_distance * np.hypot(across, 2 * along)
        return float(force.max()), float((scale * across).max())

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
        if model == "exact":
            ring_per_ampere(*self._ring, p, R, matrix, passive)
        else:
            self.check_model(model)
            dipole_per_ampere(*self._dipole, p, R, matrix)
        return WrenchMap(matrix, passive)

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
    def _ring(self) -> tuple[Array, Array, float, Array]:
        """The tool's magnet and what the core does to it, as kernels take them."""
        tool, core = self.tool, self.passive_pull
        rows = ChargedRing(tool.outer_radius, tool.inner_radius, tool.length, tool.remanence).rows
        per_current = np.array(self.moment_per_current, dtype=np.float64, order="C")
        return rows, np.array(core.table), float(core.nearest), per_current
