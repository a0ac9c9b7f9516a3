"""Gripper of a device: thumb and finger on one more degree of freedom, with a motor between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import singledispatch
from typing import final

from haptorb.devices.base import Device, device_function

__all__ = ["Gripper", "find_gripper"]


@final
@dataclass(frozen=True)
class Gripper:
    """Thumb and finger that open and close against a motor, and the hand's own that hold them.

    The coordinate is the opening between the fingertips, 0 to `opening`; a positive force opens. Its power is force
    times rate of the opening: the force is that on each of the two fingertips, away from the other.
    """

    opening: float  #: greatest [m]
    force: float  #: greatest between thumb and finger [N]
    length: float  #: from the gripper's axis to thumb and finger: opening = 2 length sin(angle / 2) [m]
    mass: float  #: apparent mass of the opening, without the hand [kg]
    coulomb: float  #: dry friction [N]
    viscous: float  #: [N·s/m]
    step: float  #: resolution of the sensed opening [m]
    finger_mass: float  #: of the hand's thumb and finger [kg]
    finger_stiffness: float  #: with which they are held at their goal [N/m]
    finger_damping: float  #: [N·s/m]


@device_function
@singledispatch
def find_gripper(device: Device) -> Gripper | None:
    """Gripper of `device`, which programs read and command; None: it has none."""
    return None
