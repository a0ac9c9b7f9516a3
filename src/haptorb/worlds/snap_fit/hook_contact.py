"""State of one hook at an instant, for drawing."""

from __future__ import annotations

from typing import NamedTuple

from haptorb.numerics.arrays import Array

__all__ = ["HookContact"]


class HookContact(NamedTuple):
    """Contact point of a hook, force and deflection."""

    face: str  #: "rear", "top" or "front", "" where nothing touches
    point: Array  #: (3,) where it is touched [m]
    force: Array  #: (3,) on the part [N]
    deflection: float  #: how far the hook is bent [m]
    place: float  #: where along the hook it is touched, from the root [m]
