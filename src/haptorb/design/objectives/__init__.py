"""What can be computed of a candidate: the quantities that design files name as objectives and constraints."""

from __future__ import annotations

from haptorb.design.objectives import motor_torque, parts, sensing, tool_force, warmth
from haptorb.design.quantity import DesignQuantity
from haptorb.errors import UnknownName

__all__ = ["quantity", "quantity_names"]

_KNOWN = {
    one.name: one
    for one in (
        *motor_torque.QUANTITIES,
        *tool_force.QUANTITIES,
        *parts.QUANTITIES,
        *warmth.QUANTITIES,
        *sensing.QUANTITIES,
    )
}


def quantity(name: str) -> DesignQuantity:
    """The quantity of that name; UnknownName with the nearest ones for another.

    >>> quantity("core_pull").unit
    'N'
    """
    if name not in _KNOWN:
        raise UnknownName("quantity", name, sorted(_KNOWN))
    return _KNOWN[name]


def quantity_names(kind: str | None = None) -> tuple[str, ...]:
    """Names of all quantities, or of those that devices of `kind` have, in alphabetical order.

    >>> "core_pull" in quantity_names("spherical-motor")
    False
    """
    return tuple(sorted(name for name, one in _KNOWN.items() if kind is None or kind in one.kinds))
