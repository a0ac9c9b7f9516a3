"""What a spherical motor's file says of its magnets, coils and field sensors: parts on rings around one centre."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Len
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from haptorb.devices.motor.layouts import Layout, PartRing, alternate_signs
from haptorb.devices.schema import key as m
from haptorb.devices.schema import quantity as q
from haptorb.devices.schema.sections import RIGHT_ANGLE, Count, Positive, Section, check_wall
from haptorb.devices.schema.sensor_sections import SensorQualitySection
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

    latitude: Annotated[
        q.Angle, Field(ge=-RIGHT_ANGLE, le=RIGHT_ANGLE), m.Meaning("latitude of the ring, seen from the motor's centre")
    ]
    count: Annotated[Count, m.Meaning("number of parts on the ring"), m.Form("≥ 1, on all rings together at most 48")]
    first: Annotated[q.Angle, m.Meaning("longitude of the first part")]
    step: Annotated[q.Angle, m.Meaning("longitude from one part to the next")]

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

    dipoles_per_loop: Annotated[Count, m.Meaning("dipoles on each loop, n")]
    length_ratio: Annotated[Share, m.Meaning("length of the dipoles over that of the part, l̄/l")]
    strengths: Annotated[
        tuple[q.Number, ...],
        Len(1, 20),
        m.Meaning("pole strengths m_0 to m_k; of coils per ampere"),
        m.Unit("A·m"),
        m.Form("any"),
    ]

    def build(self, radius: float, length: float) -> MultipoleSource:
        """The model of a body of this radius and length [m]."""
        return MultipoleSource(radius, self.length_ratio * length, self.strengths, self.dipoles_per_loop)


class MagnetsSection(Section):
    """[magnets]: the rotor's."""

    distance: Annotated[q.Length, Positive, m.Meaning("distance of the magnets' centres from the motor's centre")]
    radius: Annotated[q.Length, Positive, m.Meaning("radius of one cylinder magnet")]
    length: Annotated[q.Length, Positive, m.Meaning("length of one cylinder magnet")]
    polarization: Annotated[q.Polarization, Positive, m.Meaning("polarization of one magnet")]
    polarity: Annotated[
        Polarity,
        m.Meaning("polarity of the magnets"),
        m.Form('"checkerboard", "in-phase" or a number from −1 to 1 per magnet, +1 outward'),
    ]
    rings: Annotated[Rings, m.Meaning("rings of magnets on the rotor")]
    multipole: Annotated[
        MultipoleSection | None,
        m.Meaning("distributed multipole model of one magnet, Bai 2012 eq. (7)"),
        m.Without("none: no model published"),
    ] = None

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

    distance: Annotated[q.Length, Positive, m.Meaning("distance of the coils' centres from the motor's centre")]
    turns: Annotated[q.Number, Positive, m.Meaning("turns of one coil")]
    outer_radius: Annotated[q.Length, Positive, m.Meaning("outer radius of one winding")]
    inner_radius: Annotated[
        q.Length, Positive, m.Meaning("inner radius of one winding"), m.Form("> 0, below outer_radius")
    ]
    length: Annotated[q.Length, Positive, m.Meaning("length of one winding along its axis")]
    fill: Annotated[Share, m.Meaning("fill factor of copper in the winding's cross-section; determines the resistance")]
    rings: Annotated[Rings, m.Meaning("rings of coils on the stator")]
    multipole: Annotated[
        MultipoleSection | None,
        m.Meaning("distributed multipole model of one coil, Bai 2012 eq. (7)"),
        m.Without("none: no model published"),
    ] = None

    @model_validator(mode="after")
    def _check_winding(self) -> ElectromagnetsSection:
        check_wall(self.inner_radius, self.outer_radius)
        return self


class SensorsSection(SensorQualitySection):
    """[sensors]: three-axis field sensors on the stator."""

    distance: Annotated[q.Length, Positive, m.Meaning("distance of the field sensors from the motor's centre")]
    rings: Annotated[Rings, m.Meaning("rings of three-axis field sensors on the stator")]


class GroupsSection(Section):
    """[groups]: coils wired in series; each group is one channel."""

    coils: Annotated[
        tuple[Annotated[tuple[Coil, ...], Len(1, _MOST_PARTS)], ...],
        Len(1, _MOST_PARTS),
        m.Meaning("coils of each channel, by number, wired in series"),
        m.Form("lists of coil numbers from 1, each coil once"),
    ]
    winding: Annotated[
        Literal["series-aiding", "series-opposed"],
        m.Meaning("winding sense of the second coil of a group relative to the first"),
    ]
    antipodal: Annotated[
        bool,
        Field(strict=True),
        m.Meaning("whether the coils of every pair face each other across the centre, which is then checked"),
    ] = False


def layout(distance: float, rings: Rings) -> Layout:
    """The places of all parts of `rings`, `distance` [m] from the centre."""
    return Layout.of_rings(distance, [ring.build() for ring in rings])
