"""What a spherical motor's file says of its magnets, coils and field sensors: parts on rings around one centre."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Len
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from haptorb.devices.motor.layouts import Layout, PartRing, alternate_signs
from haptorb.devices.schema import quantity as q
from haptorb.devices.schema.sections import Count, Positive, Section, check_wall
from haptorb.errors import quote
from haptorb.numerics.arrays import Array
from haptorb.physics.sources.multipole import MultipoleSource

__all__ = [
    "ElectromagnetsSection",
    "GroupsSection",
    "MagnetsSection",
    "MultipoleSection",
    "RingSection",
    "SensorsSection",
    "layout",
]

Share = Annotated[q.Number, Field(gt=0, le=1)]
Coil = Annotated[int, Field(ge=-1000, le=1000, strict=True)]
_MOST_PARTS = 48  #: on all rings together: what is computed of them grows with their squares


def _sign(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and -1 <= value <= 1


def _polarity(value: Any) -> Any:
    if value in ("checkerboard", "in-phase"):
        return value
    signs = isinstance(value, list) and all(_sign(sign) for sign in value)
    if not signs:
        raise ValueError(
            f"must be 'checkerboard', 'in-phase' or a list of +1 (outward) and -1, one per magnet; got {quote(value)}"
        )
    return tuple(float(sign) for sign in value)


Polarity = Annotated[str | tuple[float, ...], BeforeValidator(_polarity)]


class RingSection(Section):
    """One of [[….rings]]: parts at one latitude."""

    latitude: Annotated[q.Angle, Field(ge=-np.pi / 2, le=np.pi / 2)]
    count: Count
    first: q.Angle
    step: q.Angle

    def build(self) -> PartRing:
        """As the layout has it."""
        return PartRing(self.latitude, self.count, self.first, self.step)


def _check_count(rings: tuple[RingSection, ...]) -> tuple[RingSection, ...]:
    total = sum(ring.count for ring in rings)
    if total > _MOST_PARTS:
        raise ValueError(f"must have at most {_MOST_PARTS} parts on all rings together; got {total}")
    return rings


Rings = Annotated[tuple[RingSection, ...], Len(1, _MOST_PARTS), AfterValidator(_check_count)]


class MultipoleSection(Section):
    """[….multipole]: a distributed multipole model, Bai 2012 eq. (7) and Table 1."""

    dipoles_per_loop: Count
    length_ratio: Share  #: l̄/l
    strengths: Annotated[tuple[q.Number, ...], Len(1, 20)]  #: m_0 … m_k [A·m], coils: per ampere [m]

    def build(self, radius: float, length: float) -> MultipoleSource:
        """The model of a body of this radius and length [m]."""
        return MultipoleSource(radius, self.length_ratio * length, self.strengths, self.dipoles_per_loop)


class MagnetsSection(Section):
    """[magnets]: the rotor's."""

    distance: Annotated[q.Length, Positive]
    radius: Annotated[q.Length, Positive]
    length: Annotated[q.Length, Positive]
    polarization: Annotated[q.Polarization, Positive]
    polarity: Polarity
    rings: Rings
    multipole: MultipoleSection | None = None

    @model_validator(mode="after")
    def _check_polarity(self) -> MagnetsSection:
        total = sum(ring.count for ring in self.rings)
        if not isinstance(self.polarity, str) and len(self.polarity) != total:
            raise ValueError(f"has {total} magnets but {len(self.polarity)} values of polarity")
        return self

    def signs(self) -> Array:
        """(p,) polarity of every magnet."""
        if isinstance(self.polarity, str):
            return alternate_signs([ring.count for ring in self.rings], self.polarity)
        return np.array(self.polarity)


class ElectromagnetsSection(Section):
    """[electromagnets]: the stator's coils."""

    distance: Annotated[q.Length, Positive]
    turns: Annotated[q.Number, Positive]
    outer_radius: Annotated[q.Length, Positive]
    inner_radius: Annotated[q.Length, Positive]
    length: Annotated[q.Length, Positive]
    fill: Share
    rings: Rings
    multipole: MultipoleSection | None = None

    @model_validator(mode="after")
    def _check_winding(self) -> ElectromagnetsSection:
        check_wall(self.inner_radius, self.outer_radius)
        return self


class SensorsSection(Section):
    """[sensors]: three-axis field sensors on the stator."""

    distance: Annotated[q.Length, Positive]
    rings: Rings
    noise: Annotated[q.Polarization, Ge(0)]
    step: Annotated[q.Polarization, Ge(0)]
    gain: Annotated[q.Number, Ge(0)]
    offset: Annotated[q.Polarization, Ge(0)]
    cross: Annotated[q.Number, Ge(0)]


class GroupsSection(Section):
    """[groups]: which coils are wired in series; each group is one channel."""

    coils: Annotated[
        tuple[Annotated[tuple[Coil, ...], Len(1, _MOST_PARTS)], ...], Len(1, _MOST_PARTS)
    ]  #: numbered from 1
    winding: Literal["series-aiding", "series-opposed"]
    antipodal: Annotated[bool, Field(strict=True)] = (
        False  #: the maker states that the coils of a group face each other across the centre
    )


def layout(distance: float, rings: Rings) -> Layout:
    """The places of all parts of `rings`, `distance` [m] from the centre."""
    return Layout.of_rings(distance, [ring.build() for ring in rings])
