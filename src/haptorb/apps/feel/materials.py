"""Materials that a design file may name: stiffness, Poisson ratio and yield strength."""

from __future__ import annotations

__all__ = ["MATERIALS", "YIELD_STRENGTHS"]

#: name → (E [Pa], ν, whether it is a metal): round handbook values at room temperature, for a first comparison
MATERIALS = {
    "ABS": (2.3e9, 0.35, False),
    "PA6": (2.8e9, 0.39, False),
    "PC": (2.3e9, 0.37, False),
    "POM": (2.8e9, 0.35, False),
    "PP": (1.4e9, 0.42, False),
    "brass": (93e9, 0.35, True),
    "phosphor bronze": (113e9, 0.41, True),
    "spring steel": (206e9, 0.29, True),
}

#: name → stress at yield [Pa], of the same kind and for the same use: grades differ by a third; PA6 dry, metals as
#: hard strip for springs. A design file's `yield_strength` replaces it
YIELD_STRENGTHS = {
    "ABS": 45e6,
    "PA6": 80e6,
    "PC": 62e6,
    "POM": 65e6,
    "PP": 33e6,
    "brass": 300e6,
    "phosphor bronze": 550e6,
    "spring steel": 1200e6,
}
