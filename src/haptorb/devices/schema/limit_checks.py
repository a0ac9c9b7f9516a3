"""Limits of a device file against what supply, coils and windings can do: far above it they protect from nothing.

Refused: a force or torque more than a hundred times what is possible, which is a wrong unit (N for mN), a current ten
times what the supply drives, and one at which a winding passes its stop temperature before the coils of a stopped
computer are off. Remarked: a force or torque ten times what is possible, and a current that the supply cannot drive; a
design may be there while it is made.
"""

from __future__ import annotations

import numpy as np

from haptorb.devices.device import Coils, Limits, Supply

__all__ = ["list_limit_mistakes", "list_limit_remarks"]

_WRONG_UNIT = 100.0
_NO_LIMIT = 10.0
_UNREACHABLE = 10.0  #: the supply's voltage over a resistance is no estimate
_SURPLUS = 1.25  #: a current limit that far above what the supply drives is within a coil's tolerances and warmth
_COILS_OFF = 0.1  #: after which a board's watchdog has switched off at the latest when the computer stops [s]


def list_limit_mistakes(coils: Coils, supply: Supply, limits: Limits, force: float, torque: float) -> list[str]:
    """What is refused, as sentences. force, torque: the greatest that the coils give at full current [N, N·m]; 0 where
    they give none that a limit could hold."""
    found = []
    for key, unit, limit, most in _wrenches(limits, force, torque):
        if limit > _WRONG_UNIT * most:
            found.append(
                f"limits.{key} is {limit:g} {unit}, {limit / most:.0f} times what the coils give at full current "
                f"({most:.2g} {unit}): it would limit nothing; check its unit"
            )
    driven = supply.voltage / coils.resistance
    most = _greatest_power(coils, supply)
    if _WRONG_UNIT * supply.power < most:
        found.append(
            f"supply.power is {supply.power:g} W, but one coil at its current limit takes {most:.3g} W; check its unit"
        )
    heat = coils.heat
    alike: dict[str, list[str]] = {}
    for name, current, most, ohms in zip(coils.names, coils.current_limit, driven, coils.resistance, strict=True):
        if current > _UNREACHABLE * most:
            text = (
                f"is {current:g} A, but {supply.voltage:g} V drive at most "
                f"{most:.3g} A through its {ohms:g} Ω; check its unit"
            )
            alike.setdefault(text, []).append(name)
            continue
        power = min(current, most) ** 2 * ohms
        time = heat.winding_capacity * (heat.stop - heat.ambient) / power
        if time < _COILS_OFF:
            text = (
                f"lets {min(current, most):.3g} A ({power:.3g} W) heat the winding with its {heat.winding_capacity:g} "
                f"J/K past the stop temperature in {1e3 * time:.2g} ms, before the coils of a stopped computer are "
                f"off ({1e3 * _COILS_OFF:.0f} ms): reduce it, or correct coils.heat.winding_capacity"
            )
            alike.setdefault(text, []).append(name)
    return [*found, *(f"coils.current_limit of coil {', '.join(names)} {text}" for text, names in alike.items())]


def list_limit_remarks(coils: Coils, supply: Supply, limits: Limits, force: float, torque: float) -> list[str]:
    """What is only remarked, as sentences; arguments as of `list_limit_mistakes`."""
    found = [
        f"limits.{key} is {limit:g} {unit}, {limit / most:.0f} times what the coils give at full current "
        f"({most:.2g} {unit}): it limits nothing"
        for key, unit, limit, most in _wrenches(limits, force, torque)
        if limit > _NO_LIMIT * most
    ]
    driven = supply.voltage / coils.resistance
    most = _greatest_power(coils, supply)
    if supply.power < most:
        found.append(
            f"supply.power is {supply.power:g} W, but one coil at its current limit takes {most:.3g} W: the limit is "
            "never reached, and the supply limits the peak forces"
        )
    over = np.flatnonzero(coils.current_limit > _SURPLUS * driven)
    if len(over):
        k = int(over[0])
        found.append(
            f"coils.current_limit of coil {coils.names[k]} is {coils.current_limit[k]:g} A, but {supply.voltage:g} V "
            f"drive {driven[k]:.3g} A through its {coils.resistance[k]:.3g} Ω: peak forces here are too high by "
            f"{100 * (coils.current_limit[k] / driven[k] - 1):.0f} %"
        )
    return found


def _greatest_power(coils: Coils, supply: Supply) -> float:
    """What the coil that takes most takes alone, cold [W]."""
    current = np.minimum(coils.current_limit, supply.voltage / coils.resistance)
    return float((current**2 * coils.resistance).max())


def _wrenches(limits: Limits, force: float, torque: float) -> list[tuple[str, str, float, float]]:
    pairs = [("force", "N", limits.force, force), ("torque", "N·m", limits.torque, torque)]
    return [pair for pair in pairs if pair[3] > 0.0]
