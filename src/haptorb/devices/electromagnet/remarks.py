"""What should be known of an electromagnet although it can be computed with: values of its file that contradict."""

from __future__ import annotations

import numpy as np

from haptorb.devices.device import Coils
from haptorb.devices.electromagnet.windings import Windings
from haptorb.numerics.arrays import Array
from haptorb.physics.sources.coil import COPPER_RESISTIVITY
from haptorb.physics.sources.soft_sphere import SoftSphere

__all__ = ["FORCE_JND", "list_remarks"]

FORCE_JND = 0.07  #: just-noticeable difference of a force, lower end of the published 7 to 10 %
_COPPER_AT = 293.15  #: temperature of COPPER_RESISTIVITY [K]
_MOST_FILL = np.pi / np.sqrt(12)  #: share of a section that round wires fill side by side


def list_remarks(
    coils: Coils, core: SoftSphere, windings: Windings | None, moments: Array, moments_from: str
) -> tuple[str, ...]:
    """Sentences about a device whose `moments` (3, 3) [m²] per ampere come from `moments_from`; none is a pass."""
    if windings is None:
        return ()
    return (*_moments(coils.names, windings.moment_per_current(core), moments, moments_from), *_copper(coils, windings))


def _moments(names: tuple[str, ...], predicted: Array, moments: Array, moments_from: str) -> list[str]:
    """One line where they differ in size by what a hand can feel: a force goes with the moment."""
    if moments_from == "windings":
        return []
    sizes = (np.linalg.norm(matrix, axis=0).tolist() for matrix in (moments, predicted))
    pairs = list(zip(names, *sizes, strict=True))
    if not any(abs(computed / used - 1) > FORCE_JND for _, used, computed in pairs):
        return []
    differences = "; ".join(
        f"coil {name}: {used:.4f} m², windings and core give {computed:.4f} m² ({100 * (computed / used - 1):+.0f} %)"
        for name, used, computed in pairs
    )
    origin, remedy = "moment_per_current", "correct one of them, or state windings.fill to use [windings]"
    if moments_from == "calibration":
        origin, remedy = "the calibration", "correct [windings]"
    return [f"moments differ: {differences}. Forces follow {origin}, so [windings] have no effect on them; {remedy}"]


def _copper(coils: Coils, windings: Windings) -> list[str]:
    warm = 1 + coils.temperature_coefficient * (coils.reference_temperature - _COPPER_AT)
    fill = windings.fill(coils.resistance, COPPER_RESISTIVITY * warm)
    coils_below = [
        f"coil {name}: {windings.turns[k]:g} turns of copper in its section have at least "
        f"{coils.resistance[k] * fill[k] / _MOST_FILL:.2g} Ω, coils.resistance says {coils.resistance[k]:g} Ω"
        for k, name in enumerate(coils.names)
        if fill[k] > _MOST_FILL
    ]
    if not coils_below:
        return []
    return [
        f"resistance too low: {'; '.join(coils_below)}. Correct coils.resistance, or the turns or sizes of [windings]"
    ]
