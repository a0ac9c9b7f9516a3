"""The multipole models that Bai 2012 prints in Table 1, in the readings that its missing units leave open (erratum E1).

Strengths are printed in "μA/m", lengths without a unit. A pole strength is in A·m, and only one reading of the lengths
lets moments agree: l = 0.2 and 0.3 inch (a = 15.875 mm is 0.625 inch) and l̄/l = 0.2 for the magnet instead of the
printed 0.3. The other readings stay here by name, to be compared, not used.
"""

from __future__ import annotations

from dataclasses import dataclass

from haptorb.errors import UnknownName
from haptorb.physics.sources.coil import Coil
from haptorb.physics.sources.cylinder import CylinderMagnet
from haptorb.physics.sources.multipole import MultipoleSource
from haptorb.physics.sources.round_body import RoundBody

__all__ = ["PUBLISHED", "PublishedModel", "load_published"]

MAGNET_RADIUS = 15.875e-3  #: [m]
COIL_RADIUS = 15.88e-3  #: [m]
MAGNET_STRENGTHS = (33.5, 24.5, 57.6, 52.0, 276.1)  #: m_0 … m_4 [A·m]
COIL_STRENGTHS = (1.476, 0.547, 1.618, 1.644, 1.654, 1.325, 0.592)  #: m_0 … m_6 [A·m per A]


@dataclass(frozen=True, slots=True)
class PublishedModel:
    """One reading of one column of Table 1: the body as it is, and the model that stands for it."""

    body: RoundBody
    model: MultipoleSource
    reading: str  #: what was read how


def _magnet(length: float, ratio: float, reading: str) -> PublishedModel:
    body = CylinderMagnet(MAGNET_RADIUS, length, 1.31)
    return PublishedModel(body, MultipoleSource(MAGNET_RADIUS, ratio * length, MAGNET_STRENGTHS, 10), reading)


def _coil(length: float, reading: str) -> PublishedModel:
    body = Coil(1000, 0.3 * COIL_RADIUS, COIL_RADIUS, length)
    return PublishedModel(body, MultipoleSource(COIL_RADIUS, 0.442 * length, COIL_STRENGTHS, 16), reading)


#: by name, the reading to use first
PUBLISHED = {
    "bai2012-pm": _magnet(5.08e-3, 0.2, "l = 0.2 inch, l̄/l = 0.2 (printed 0.3): moments agree to 0.2 %"),
    "bai2012-em": _coil(7.62e-3, "l = 0.3 inch, l̄/l = 0.442 as printed"),
    "bai2012-pm-printed": _magnet(5.08e-3, 0.3, "l = 0.2 inch, l̄/l = 0.3 as printed: the moment is 50 % too large"),
    "bai2012-em-aspect": _coil(9.525e-3, "l/2a = 0.3 instead of inches: torque about 30 % too large"),
}


def load_published(name: str) -> PublishedModel:
    """A model of `PUBLISHED` by name, or UnknownName.

    >>> load_published("bai2012-pm").model.dipoles
    41
    """
    if name not in PUBLISHED:
        raise UnknownName("published multipole model", name, PUBLISHED)
    return PUBLISHED[name]
