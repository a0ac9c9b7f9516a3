"""What a spherical motor's file says of the rotor: its body, what holds it up, who holds it, and where it stops."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Ge, Len
from pydantic import Field, model_validator

from haptorb.devices.schema import quantity as q
from haptorb.devices.schema.sections import Positive, Section
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

    tilt: Annotated[q.Angle, Field(gt=0, lt=np.pi / 2)]


class EndStopSection(Section):
    """[end_stop]: what the rotor meets at the edge of the workspace."""

    stiffness: Annotated[q.TurnStiffness, Positive]
    damping: Annotated[q.TurnDamping, Ge(0)]


class GripSection(Section):
    """[hand]: who holds the handle's end."""

    mass: Annotated[q.Mass, Ge(0)]
    stiffness: Annotated[q.Stiffness, Ge(0)]
    damping: Annotated[q.Damping, Ge(0)]
    radius: Annotated[q.Length, Ge(0)]


class RotorSection(Section):
    """[rotor]"""

    mass: Annotated[q.Mass, Positive]
    inertia: Annotated[tuple[Annotated[q.Inertia, Positive], ...], Len(3, 3)]
    centre_of_mass: q.Length
    viscous_friction: Annotated[q.TurnDamping, Ge(0)]
    dry_friction: Annotated[q.Torque, Ge(0)]
    handle_length: Annotated[q.Length, Positive]

    @model_validator(mode="after")
    def _check_inertia(self) -> RotorSection:
        if 2 * max(self.inertia) > sum(self.inertia):
            raise ValueError("inertia must obey I1 ≤ I2 + I3, as every body's does")
        return self


class RegulatorRingSection(Section):
    """[regulator.stator] or [regulator.rotor]"""

    outer_radius: Annotated[q.Length, Positive]
    inner_radius: Annotated[q.Length, Positive]
    length: Annotated[q.Length, Positive]
    polarization: Annotated[q.Polarization, Positive]
    height: q.Length

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

    stator: RegulatorRingSection
    rotor: RegulatorRingSection
