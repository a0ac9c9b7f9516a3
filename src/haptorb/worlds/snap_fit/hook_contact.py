"""What one hook does at a moment, for those who draw it."""

from __future__ import annotations

from typing import NamedTuple

from haptorb.numerics.arrays import Array

__all__ = ["HookContact"]


class HookContact(NamedTuple):
    """Where a hook is touched, with what force, and how far it is bent."""

    face: str  #: "rear", "top" or "front", "" where nothing touches
    point: Array  #: (3,) where it is touched [m]
    force: Array  #: (3,) on the part [N]
    deflection: float  #: how far the hook is bent [m]
    place: float  #: where along the hook it is touched, from the root [m]
