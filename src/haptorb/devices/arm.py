"""Conventional haptic arm: an end effector driven by motors, with encoders, friction and a workspace."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Array
from haptorb.devices.base import Device, DeviceKind, State, WrenchMap, check_distance
from haptorb.devices.electromagnet import Hand
from haptorb.devices.geometry import Edge, Geometry, Rod, list_assumed
from haptorb.devices.gripper import Gripper, find_gripper
from haptorb.devices.schema import list_limit_remarks
from haptorb.display import format_quantity
from haptorb.errors import InputError

__all__ = ["ARM", "Arm", "ArmEncoder", "ArmStops", "ArmWorkspace", "EndEffector", "arm_geometry"]

ARM = DeviceKind(
    name="arm",
    title="haptic arm",
    world="wall",
)

_MAX_OUTSIDE_M = 0.02  #: how far outside the workspace a hand may pull: it leans on the stops [m]


@final
@dataclass(frozen=True)
class EndEffector:
    """Apparent mass and friction at the end effector, the same in every direction."""

    mass: float  #: [kg]
    inertia: float  #: about every axis [kg·m²]
    coulomb: float  #: dry friction against translation [N]
    viscous: float  #: [N·s/m]
    turn_coulomb: float  #: dry friction against rotation [N·m]
    turn_viscous: float  #: [N·m·s/rad]
    orientation: str  #: "fixed", "sensed" (a passive wrist) or "actuated"


@final
@dataclass(frozen=True)
class ArmEncoder:
    """Resolution of the sensed pose, and the time over which velocity is computed from it."""

    step: float  #: [m]
    turn_step: float  #: [rad]
    velocity_window: float  #: [s]


@final
@dataclass(frozen=True)
class ArmWorkspace:
    """Workspace: a box, or a cylinder about the y axis, centred on the origin.

    The stator's frame: x to the user's right, y away from the user, z up.
    """

    shape: str  #: "box" or "cylinder"
    half: tuple[float, float, float]  #: half widths along x, y, z; of a cylinder the radius, half length, radius [m]

    def contains(self, places: Array, margin: float = 0.0) -> NDArray[np.bool_]:
        """(n,) whether each of `places` (n, 3) [m] is inside, or outside by at most `margin` [m]."""
        x, y, z = (np.asarray(self.half) + margin).tolist()
        if self.shape == "cylinder":
            return np.asarray((np.hypot(places[:, 0], places[:, 2]) <= x) & (np.abs(places[:, 1]) <= y))
        return np.asarray((np.abs(places) <= (x, y, z)).all(axis=1))

    def describe(self) -> str:
        """Describe the workspace in words."""
        x, y, z = (2e3 * side for side in self.half)
        if self.shape == "cylinder":
            return f"cylinder of {x:g} mm diameter, {y:g} mm along the user's line of sight"
        return f"{x:g} × {y:g} × {z:g} mm (width, depth, height)"


@final
@dataclass(frozen=True)
class ArmStops:
    """Mechanical stops at the edge of the workspace."""

    stiffness: float  #: [N/m]
    damping: float  #: [N·s/m]


@dataclass(frozen=True, kw_only=True)
class Arm(Device):
    """Haptic arm with motors, described at its end effector.

    Built from a device file of the kind "arm". Parameters beside those of `haptorb.Device`:

    Parameters
    ----------
    effector : EndEffector
        Apparent mass [kg], inertia [kg·m²] and friction [N] at the end effector.
    workspace : ArmWorkspace
        Workspace of the end effector [m].
    stops : ArmStops
        Mechanical stops at its edge.
    encoder : ArmEncoder
        Resolution of the sensed pose [m].
    force_per_ampere : float
        Force of a channel [N/A], the same everywhere in the workspace.
    torque_per_ampere : float
        Torque of a channel [N·m/A]; 0: the orientation is not actuated.
    stiffness_limit : float
        Largest stiffness that the maker or a library specifies [N/m].
    gripper : Gripper or None
        Gripper, which programs read and command.
    hand : Hand
        Simulated hand that holds the end effector.
    thermometer_step : float
        Resolution of the motors' temperatures [K].
    thermometer_noise : float
        Standard deviation of one temperature reading [K].

    Notes
    -----
    Model "uniform": each channel gives force along one axis of the stator's frame, or torque about it, in proportion to
    its current. Kinematics, the change of mass, friction and forces over the workspace, elasticity of the links and
    gravity (which is compensated) are left out.
    """

    kind: ClassVar[DeviceKind] = ARM

    effector: EndEffector
    workspace: ArmWorkspace
    stops: ArmStops
    encoder: ArmEncoder
    force_per_ampere: float
    torque_per_ampere: float
    stiffness_limit: float
    gripper: Gripper | None
    hand: Hand
    thermometer_step: float
    thermometer_noise: float

    models: tuple[str, ...] = ("uniform",)

    @property
    def is_upright(self) -> bool:
        """The end effector's orientation does not depend on its position."""
        return True

    @property
    def is_turned(self) -> bool:
        """Whether torque is rendered."""
        return self.effector.orientation == "actuated"

    @property
    def turning_arm(self) -> float:
        """Arm at which the hand's damping against turning is that against moving [m]; 0: no torque is rendered."""
        hand = self.hand
        return (hand.turn_damping / hand.damping) ** 0.5 if self.is_turned and hand.damping > 0.0 else 0.0

    @property
    def matrix(self) -> Array:
        """(6, m) force [N/A] and torque [N·m/A] of each channel."""
        made = np.zeros((6, self.channels))
        for k in range(3):
            made[k, k] = self.force_per_ampere
            if self.channels == 6:
                made[3 + k, 3 + k] = self.torque_per_ampere
        return made

    def geometry(self) -> Geometry:
        """The edges of the workspace, and the end effector."""
        return arm_geometry(self)

    def wrench_map(self, state: State, model: str) -> WrenchMap:
        """(6, m) per ampere, the same everywhere; nothing at zero current."""
        self.check_model(model)
        return WrenchMap(self.matrix, np.zeros(6), self.coils.names)

    def check_hand_goals(self, places: Array, what: str) -> None:
        """Raise InputError for goals of a hand more than 20 mm outside the workspace."""
        check_distance(places, what)
        inside = self.workspace.contains(places, _MAX_OUTSIDE_M)
        if not inside.all():
            number = int(np.argmin(inside))
            at = ", ".join(f"{1e3 * x:.4g}" for x in places[number].tolist())
            raise InputError(
                f"{what} leads to ({at}) mm, outside the workspace of '{self.name}': {self.workspace.describe()} about "
                "the origin"
            )

    @property
    def greatest_wrench(self) -> tuple[float, float]:
        """Force along one axis [N] and torque about it [N·m] at the current limit."""
        current = self.driven_current
        return float(self.force_per_ampere * current[:3].min()), float(
            self.torque_per_ampere * (current[3:].min() if self.channels == 6 else 0.0)
        )

    @property
    def continuous_wrench(self) -> tuple[float, float]:
        """The same for any time, with all motors warm [N, N·m]."""
        current = self.sustained_current_together
        return float(self.force_per_ampere * current[:3].min()), float(
            self.torque_per_ampere * (current[3:].min() if self.channels == 6 else 0.0)
        )

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on inconsistent values of this device, which prevent no computation."""
        return tuple(list_limit_remarks(self.coils, self.supply, self.limits, *self.greatest_wrench))

    def _list_facts(self) -> list[tuple[str, str]]:
        effector = self.effector
        head, tail = Device._list_facts(self)[:2], Device._list_facts(self)[2:]
        return [
            *head,
            ("workspace", self.workspace.describe()),
            ("end effector", f"{format_quantity(effector.mass, 'kg')}, friction {effector.coulomb:g} N, orientation "
                             f"{effector.orientation}"),
            *tail,
            *(("remark", remark) for remark in self.remarks),
        ]  # fmt: skip


@find_gripper.register
def _(device: Arm) -> Gripper | None:
    return device.gripper


_ROUND = 36  #: sides of a drawn circle


def arm_geometry(device: Arm) -> Geometry:
    """The edges of the workspace, and the end effector in its middle; links and motors are not in the file."""
    x, y, z = device.workspace.half
    if device.workspace.shape == "cylinder":
        turn = 2 * np.pi * np.arange(_ROUND) / _ROUND
        ring = np.stack([x * np.cos(turn), 0 * turn, x * np.sin(turn)], axis=1)
    else:
        ring = np.array([(x, 0.0, z), (-x, 0.0, z), (-x, 0.0, -z), (x, 0.0, -z)])
    depth = np.array([0.0, y, 0.0])
    closed = np.concatenate([ring, ring[:1]])
    edges = [closed + side * depth for side in (-1.0, 1.0)]
    edges += [np.stack([corner - depth, corner + depth]) for corner in ring[:: max(len(ring) // 4, 1)]]
    return Geometry(
        round_parts=(),
        rods=(Rod("end effector", -0.5 * depth, np.zeros(3)),),
        edges=tuple(Edge(f"workspace, edge {number}", points) for number, points in enumerate(edges, 1)),
        notes=(
            "not stated in the device file: links, joints and motors",
            *list_assumed(device.assumed, ("workspace",)),
        ),
    )
