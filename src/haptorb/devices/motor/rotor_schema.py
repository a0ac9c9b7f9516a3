"""What a spherical motor's file says of the rotor: its body, what holds it up, who holds it, and where it stops."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Len
from pydantic import Field, model_validator

from haptorb.devices.schema import key as m
from haptorb.devices.schema import quantity as q
from haptorb.devices.schema.sections import RIGHT_ANGLE, Positive, Section
from haptorb.physics.sources.ring import RingMagnet

__all__ = [
    "EndStopSection",
    "GripSection",
    "RegulatorRingSection",
    "RegulatorSection",
    "RotorSection",
    "WorkspaceSection",
]


class WorkspaceSection(Section):
    """[workspace]: |ψ| and |λ| up to `tilt`, any φ."""

    tilt: Annotated[
        q.Angle, Field(gt=0, lt=RIGHT_ANGLE), m.Meaning("maximum tilt |ψ| and |λ| of the rotor; spin is free")
    ]


class EndStopSection(Section):
    """[end_stop]: mechanical stop at the edge of the workspace."""

    stiffness: Annotated[q.TurnStiffness, Positive, m.Meaning("rotational stiffness of the stop")]
    damping: Annotated[q.TurnDamping, Ge(0), m.Meaning("rotational damping of the stop")]


class GripSection(Section):
    """[hand]: who holds the handle's end."""

    mass: Annotated[q.Mass, Ge(0), m.Meaning("mass that the hand adds at the handle's end")]
    stiffness: Annotated[q.Stiffness, Ge(0), m.Meaning("stiffness of the grip along each axis")]
    damping: Annotated[q.Damping, Ge(0), m.Meaning("damping of the grip along each axis")]
    radius: Annotated[q.Length, Ge(0), m.Meaning("radius of the fist, for its inertia and grip about the handle")]


class RotorSection(Section):
    """[rotor]"""

    mass: Annotated[q.Mass, Positive, m.Meaning("mass of the rotor with its magnets and handle")]
    inertia: Annotated[
        tuple[Annotated[q.Inertia, Positive], ...],
        Len(3, 3),
        m.Meaning("principal moments of inertia about the motor's centre: x, y, and z along the handle"),
        m.Form("> 0, none above the sum of the others"),
    ]
    centre_of_mass: Annotated[
        q.Length, m.Meaning("height of the centre of mass over the motor's centre, along the handle")
    ]
    viscous_friction: Annotated[q.TurnDamping, Ge(0), m.Meaning("viscous friction of the bearing")]
    dry_friction: Annotated[q.Torque, Ge(0), m.Meaning("dry friction of the bearing")]
    handle_length: Annotated[q.Length, Positive, m.Meaning("distance from the motor's centre to the handle's end")]

    @model_validator(mode="after")
    def _check_inertia(self) -> RotorSection:
        if 2 * max(self.inertia) > sum(self.inertia):
            raise ValueError("inertia must obey I1 ≤ I2 + I3, like every rigid body")
        return self


class RegulatorRingSection(Section):
    """[regulator.stator] or [regulator.rotor]"""

    outer_radius: Annotated[q.Length, Positive, m.Meaning("outer radius of the ring magnet")]
    inner_radius: Annotated[
        q.Length, Positive, m.Meaning("inner radius of the ring magnet"), m.Form("> 0, below outer_radius")
    ]
    length: Annotated[q.Length, Positive, m.Meaning("length of the ring along its axis")]
    polarization: Annotated[q.Polarization, Positive, m.Meaning("polarization of the ring")]
    height: Annotated[q.Length, m.Meaning("height of the ring's centre over the motor's centre")]

    @model_validator(mode="after")
    def _check_ring(self) -> RegulatorRingSection:
        if self.inner_radius >= self.outer_radius:
            raise ValueError("inner_radius must be smaller than outer_radius")
        return self

    def build(self) -> RingMagnet:
        """The ring's magnet."""
        return RingMagnet(self.outer_radius, self.inner_radius, self.length, self.polarization)


class RegulatorSection(Section):
    """[regulator]: two opposed rings that hold the rotor up."""

    stator: Annotated[RegulatorRingSection, m.Meaning("ring on the base")]
    rotor: Annotated[RegulatorRingSection, m.Meaning("ring on the rotor")]
