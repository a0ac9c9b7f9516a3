"""Schema of the file of a haptic arm, in addition to the sections of every device file."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Len
from pydantic import Field, model_validator

from haptorb.devices import quantity as q
from haptorb.devices import schema as m
from haptorb.devices.arm import Arm, ArmEncoder, ArmStops, ArmWorkspace, EndEffector
from haptorb.devices.build_checks import refuse_unbuildable
from haptorb.devices.electromagnet import Hand
from haptorb.devices.electromagnet_file import HandSection
from haptorb.devices.gripper import Gripper
from haptorb.devices.schema import (
    BasedOn,
    CommonFile,
    Drop,
    Positive,
    Section,
    ThermometerSection,
    limit_currents,
    list_limit_mistakes,
)
from haptorb.errors import DeviceError

__all__ = ["ArmFile"]


class EffectorSection(Section):
    """[effector]"""

    mass: Annotated[q.Mass, Positive, m.Meaning("apparent mass at the end effector")]
    coulomb: Annotated[q.Force, Field(ge=0), m.Meaning("dry friction against translation")]
    viscous: Annotated[q.Damping, Field(ge=0), m.Meaning("viscous friction against translation")]
    orientation: Annotated[
        Literal["fixed", "sensed", "actuated"],
        m.Meaning("orientation of the end effector: it cannot turn, it turns freely, or torque is rendered"),
    ]
    inertia: Annotated[q.Inertia, Positive, m.Meaning("moment of inertia about every axis")] = 1e-4
    turn_coulomb: Annotated[q.Torque, Field(ge=0), m.Meaning("dry friction against rotation")] = 0.0
    turn_viscous: Annotated[q.TurnDamping, Field(ge=0), m.Meaning("viscous friction against rotation")] = 0.0


class ArmWorkspaceSection(Section):
    """[workspace]"""

    shape: Annotated[
        Literal["box", "cylinder"], m.Meaning("a box, or a cylinder about the y axis, which points away from the user")
    ]
    half: Annotated[
        tuple[Annotated[q.Length, Positive, Field(le=1.0)], ...],
        Len(3, 3),
        m.Meaning("half widths along x (right), y (away from the user) and z (up)"),
        m.Form("three lengths, each at most 1 m; of a cylinder radius, half length, radius"),
    ]

    @model_validator(mode="after")
    def _check(self) -> ArmWorkspaceSection:
        if self.shape == "cylinder" and self.half[0] != self.half[2]:
            raise ValueError("half must have the radius of a cylinder twice: radius, half length, radius")
        return self

    def build(self) -> ArmWorkspace:
        """Convert to the device's own form."""
        return ArmWorkspace(self.shape, (self.half[0], self.half[1], self.half[2]))


class StopsSection(Section):
    """[stops]"""

    stiffness: Annotated[q.Stiffness, Positive, m.Meaning("stiffness of the mechanical stops")]
    damping: Annotated[q.Damping, Field(ge=0), m.Meaning("damping of the mechanical stops")]


class EncoderSection(Section):
    """[encoder]"""

    step: Annotated[q.Length, Field(ge=0), m.Meaning("resolution of the sensed position along each axis")]
    turn_step: Annotated[q.Angle, Field(ge=0), m.Meaning("resolution of the sensed rotation")] = 0.0
    velocity_window: Annotated[
        q.Duration, Positive, Field(le=0.1), m.Meaning("time over which velocity is computed from positions")
    ]


class MotorsSection(Section):
    """[motors]"""

    force_per_ampere: Annotated[q.Number, Positive, m.Meaning("force of a motor at the end effector"), m.Unit("N/A")]
    torque_per_ampere: Annotated[
        q.Number | None, Positive, m.Meaning("torque of a motor of the wrist"), m.Unit("N·m/A"),
        m.Without("no torque: only for an actuated orientation"),
    ] = None  # fmt: skip
    stiffness_limit: Annotated[
        q.Stiffness, Positive, m.Meaning("largest stiffness that the maker or a library specifies")
    ]


class GripperSection(Section):
    """[gripper]"""

    opening: Annotated[q.Length, Positive, m.Meaning("greatest opening of the gripper")]
    force: Annotated[q.Force, Positive, m.Meaning("greatest force between thumb and finger")]
    length: Annotated[q.Length, Positive, m.Meaning("from the gripper's axis to thumb and finger")] = 0.1
    mass: Annotated[q.Mass, Positive, m.Meaning("apparent mass of the opening, without the hand")] = 0.02
    coulomb: Annotated[q.Force, Field(ge=0), m.Meaning("dry friction of the opening")] = 0.05
    viscous: Annotated[q.Damping, Field(ge=0), m.Meaning("viscous friction of the opening")] = 0.2
    step: Annotated[q.Length, Field(ge=0), m.Meaning("resolution of the sensed opening")] = 1e-5
    finger_mass: Annotated[q.Mass, Positive, m.Meaning("mass of the simulated thumb and finger")] = 0.02
    finger_stiffness: Annotated[
        q.Stiffness, Positive, m.Meaning("stiffness with which thumb and finger are held at their goal")
    ] = 300.0
    finger_damping: Annotated[q.Damping, Field(ge=0), m.Meaning("damping of thumb and finger")] = 2.0

    @model_validator(mode="after")
    def _check(self) -> GripperSection:
        if self.opening > 2.0 * self.length:
            raise ValueError("opening must be at most twice the length, from the axis to thumb and finger")
        return self


class ArmFile(CommonFile):
    """A file of kind "arm"."""

    kind: Annotated[Literal["arm"], m.Meaning("kind of device")]
    based_on: BasedOn = None
    drop: Drop = ()
    effector: Annotated[EffectorSection, m.Meaning("apparent mass and friction at the end effector")]
    workspace: Annotated[ArmWorkspaceSection, m.Meaning("where the end effector can be")]
    stops: Annotated[StopsSection, m.Meaning("mechanical stops at the edge of the workspace")]
    encoder: Annotated[EncoderSection, m.Meaning("how the pose is sensed")]
    motors: Annotated[MotorsSection, m.Meaning("what the motors give at the end effector")]
    gripper: Annotated[GripperSection | None, m.Meaning("a gripper"), m.Without("none")] = None
    hand: Annotated[HandSection, m.Meaning("the hand that holds the end effector, for simulation and stability")]
    thermometer: Annotated[ThermometerSection, m.Meaning("temperatures of the motors as the controller reads them")]

    @model_validator(mode="after")
    def _check_channels(self) -> ArmFile:
        count, actuated = len(self.coils.names), self.effector.orientation == "actuated"
        if count != (6 if actuated else 3):
            raise ValueError(
                f"coils.names has {count} channels; an arm has 3, one along each axis, or 6 if effector.orientation is "
                "'actuated'"
            )
        if actuated != (self.motors.torque_per_ampere is not None):
            raise ValueError("motors.torque_per_ampere belongs to an arm whose effector.orientation is 'actuated'")
        return self

    def build(self, assumed: dict[str, str], digest: str, *, override: bool = False) -> Arm:
        """The device that this file describes; DeviceError with everything that cannot be."""
        common = self.common()
        common["coils"] = limit_currents(common["coils"], common["supply"])
        device = Arm(
            **common,
            assumed=assumed,
            digest=digest,
            effector=EndEffector(**self.effector.model_dump()),
            workspace=self.workspace.build(),
            stops=ArmStops(**self.stops.model_dump()),
            encoder=ArmEncoder(**self.encoder.model_dump()),
            force_per_ampere=self.motors.force_per_ampere,
            torque_per_ampere=self.motors.torque_per_ampere or 0.0,
            stiffness_limit=self.motors.stiffness_limit,
            gripper=None if self.gripper is None else Gripper(**self.gripper.model_dump()),
            hand=Hand(**self.hand.model_dump()),
            thermometer_step=self.thermometer.step,
            thermometer_noise=self.thermometer.noise,
        )
        if not override:
            refuse_unbuildable(self.name, device.build_checks, [])
        wrong = list_limit_mistakes(device.coils, device.supply, device.limits, *device.greatest_wrench)
        if wrong:
            raise DeviceError("\n".join(f"device '{self.name}': {line}" for line in wrong))
        return device
