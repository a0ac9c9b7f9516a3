"""Materials of hooks: round handbook values at room temperature, for a first comparison of designs.

The yield strength is that of tension: for metals the 0.2 % proof stress of the spring or hard temper that hooks are
made of, for polymers the stress at yield in a short pull, dry. A polymer bent often, warm or for long bears less.
"""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["MATERIALS", "Material"]


class Material(NamedTuple):
    """What a hook's stiffness and strength follow from."""

    youngs_modulus: float  #: E [Pa]
    poisson_ratio: float  #: ν
    metal: bool
    yield_strength: float  #: [Pa]


MATERIALS = {
    "ABS": Material(2.3e9, 0.35, False, 40e6),
    "PA6": Material(2.8e9, 0.39, False, 75e6),
    "PC": Material(2.3e9, 0.37, False, 62e6),
    "POM": Material(2.8e9, 0.35, False, 65e6),
    "PP": Material(1.4e9, 0.42, False, 33e6),
    "brass": Material(93e9, 0.35, True, 300e6),  # CuZn37, hard
    "phosphor bronze": Material(113e9, 0.41, True, 550e6),  # CuSn6, spring temper
    "spring steel": Material(206e9, 0.29, True, 1.2e9),  # hardened and tempered
}
