"""What should be known of an electromagnet although it can be computed with: values of its file that contradict."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from haptorb.physics.sources.coil import COPPER_RESISTIVITY

if TYPE_CHECKING:
    from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet

__all__ = ["FORCE_JND", "list_remarks", "moment_differences"]

FORCE_JND = 0.07  #: just-noticeable difference of a force, lower end of the published 7 to 10 %
_COPPER_AT = 293.15  #: temperature of COPPER_RESISTIVITY [K]
_MOST_FILL = np.pi / np.sqrt(12)  #: share of a section that round wires fill side by side


def list_remarks(device: SphericalElectromagnet) -> tuple[str, ...]:
    """Sentences about `device`; none is a pass."""
    return (*_moments(device), *_copper(device))


def moment_differences(device: SphericalElectromagnet) -> tuple[tuple[str, float, float], ...]:
    """(coil, moment in use, moment from windings and core) [m²], along each coil's axis; nothing to compare: empty."""
    predicted = device.predict_moments()
    if predicted is None or device.moments_from == "windings":
        return ()
    return tuple(
        (name, float(device.moment_per_current[k, k]), float(predicted[k, k]))
        for k, name in enumerate(device.coils.names)
    )


def _moments(device: SphericalElectromagnet) -> list[str]:
    """One line where they differ by what a hand can feel: a force goes with the moment."""
    pairs = moment_differences(device)
    if not any(abs(computed / used - 1) > FORCE_JND for _, used, computed in pairs):
        return []
    told = "; ".join(
        f"coil {name}: {used:.4f} m², windings and core give {computed:.4f} m² ({100 * (computed / used - 1):+.0f} %)"
        for name, used, computed in pairs
    )
    origin, remedy = "moment_per_current", "correct one of them, or leave out moment_per_current to use [windings]"
    if device.moments_from == "calibration":
        origin, remedy = "the calibration", "correct [windings]"
    return [f"moments differ: {told}. Forces follow {origin}, so [windings] have no effect on them; {remedy}"]


def _copper(device: SphericalElectromagnet) -> list[str]:
    if device.windings is None:
        return []
    coils = device.coils
    warm = 1 + coils.temperature_coefficient * (coils.reference_temperature - _COPPER_AT)
    fill = device.windings.fill(coils.resistance, COPPER_RESISTIVITY * warm)
    told = [
        f"coil {name}: {device.windings.turns[k]:g} turns of copper in its section have at least "
        f"{coils.resistance[k] * fill[k] / _MOST_FILL:.2g} Ω, coils.resistance says {coils.resistance[k]:g} Ω"
        for k, name in enumerate(coils.names)
        if fill[k] > _MOST_FILL
    ]
    if not told:
        return []
    return [f"resistance too low: {'; '.join(told)}. Correct coils.resistance, or the turns or sizes of [windings]"]
