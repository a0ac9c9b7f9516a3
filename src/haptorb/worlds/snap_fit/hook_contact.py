"""State of one hook at an instant: as compiled code fills it, and for drawing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from haptorb.numerics.arrays import Array, Record, Records, fields
from haptorb.numerics.compiled import kernel

__all__ = ["CONTACT", "HookContact", "add_contact", "view_contacts"]

#: The numbers of a contact in the order of `ContactWorld.render_contacts`.
CONTACT = fields(
    ("deflection", "f8"),  # how far the hook is bent [m]
    ("place", "f8"),  # where along the hook it is touched, from the root [m]
    ("point", "f8", (3,)),  # where it is touched [m]
    ("force", "f8", (3,)),  # on the part [N]
)


class HookContact(NamedTuple):
    """Contact point of a hook, force and deflection."""

    face: str  #: "rear", "top" or "front", "" where nothing touches
    point: Array  #: (3,) where it is touched [m]
    force: Array  #: (3,) on the part [N]
    deflection: float  #: how far the hook is bent [m]
    place: float  #: where along the hook it is touched, from the root [m]


def view_contacts(rows: Array) -> Records:
    """(n,) CONTACT, the same memory as rows (n, 8)."""
    return np.ndarray(len(rows), CONTACT, rows)  # rows.view costs three times as much


@kernel
def add_contact(contact: Record, wrench: Array, p: Array, rx: float, ry: float, rz: float) -> None:
    """Put `contact`, a CONTACT with its force, at the arm (rx, ry, rz) from p (3,) [m]; add its force to wrench (6,),
    whose torque is about p."""
    contact.point[0], contact.point[1], contact.point[2] = p[0] + rx, p[1] + ry, p[2] + rz
    fx, fy, fz = contact.force[0], contact.force[1], contact.force[2]
    wrench[0] += fx
    wrench[1] += fy
    wrench[2] += fz
    wrench[3] += ry * fz - rz * fy
    wrench[4] += rz * fx - rx * fz
    wrench[5] += rx * fy - ry * fx
