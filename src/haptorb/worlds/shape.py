"""Bodies that the console draws for a world with memory, at poses from its memory."""

from __future__ import annotations

from dataclasses import dataclass

from haptorb.errors import InputError, UnknownName

__all__ = ["SHAPES", "Shape"]

#: kind → how many numbers its `size` has, all [m]: sphere radius; capsule and cylinder radius and half length along
#: their own z axis; box half lengths; ellipsoid radii; a mesh has points
SHAPES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3, "mesh": 0}


@dataclass(frozen=True)
class Shape:
    """A body that the console draws at a pose from the memory.

    kind      "sphere", "capsule", "cylinder" or "box", see `SHAPES`
    size      its dimensions [m]
    place     memory field with its centre, (3,) [m], in the frame of the world's states
    attitude  memory field with its orientation, a quaternion (x, y, z, w); empty: along the frame
    row       row of those fields, if they are tables (n, 3) and (n, 4)
    at        (7,) initial centre [m] and quaternion; without place and attitude it stays there
    role      "held", "moves", "fixed" or "path", for its colour; empty: only one kind of body
    points    (3 n,) x, y, z of a mesh's vertices [m]
    corners   (3 m,) indices of the vertices of its triangles
    """

    name: str
    kind: str
    size: tuple[float, ...]
    place: str
    attitude: str = ""
    row: int = 0
    at: tuple[float, ...] = ()
    role: str = ""
    points: tuple[float, ...] = ()
    corners: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in SHAPES:
            raise UnknownName("shape", self.kind, SHAPES)
        if len(self.size) != SHAPES[self.kind] or not all(0.0 < one < 10.0 for one in self.size):
            raise InputError(
                f"shape '{self.name}': a {self.kind} has {SHAPES[self.kind]} measures above 0 m and below 10 m; got "
                f"{self.size}"
            )
