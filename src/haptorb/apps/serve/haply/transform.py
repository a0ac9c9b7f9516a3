"""Axes, mount and scale as that service's clients set them: where they see the cursor, and whither their forces point.

The order is that of the service's documentation: from the device's own frame (X to the right, Y forward, Z up) through
the basis, which names the axes, then the mount, then the transform of the workspace, both in the axes that the basis
names.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, sqrt
from typing import Any

from haptorb.errors import InputError

__all__ = ["IDENTITY", "Basis", "Transform", "Vector", "multiply", "parse_basis", "parse_transform", "rotate"]

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  #: x, y, z, w

_FARTHEST = 1e3  #: a mount lies within [m], and its scale below


def rotate(q: Quaternion, v: Sequence[float]) -> Vector:
    """`v` (3,) turned by the quaternion `q` (x, y, z, w) of length 1; in the unit of `v` [any]."""
    x, y, z, w = q
    a, b, c = v
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return (a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx)


def multiply(p: Quaternion, q: Quaternion) -> Quaternion:
    """The quaternion (4,) (x, y, z, w) [1] of the turn `q`, then the turn `p`."""
    a, b, c, d = p
    x, y, z, w = q
    return (
        d * x + a * w + b * z - c * y,
        d * y - a * z + b * w + c * x,
        d * z + a * y - b * x + c * w,
        d * w - a * x - b * y - c * z,
    )


@dataclass(frozen=True)
class Transform:
    """v → position + rotation · (scale v): `position` [m], `rotation` (x, y, z, w), `scale` along each axis."""

    position: Vector = (0.0, 0.0, 0.0)
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    scale: Vector = (1.0, 1.0, 1.0)

    def place(self, p: Sequence[float]) -> Vector:
        """Of a point (3,) [m]."""
        x, y, z = self.turn(p)
        return (x + self.position[0], y + self.position[1], z + self.position[2])

    def turn(self, v: Sequence[float]) -> Vector:
        """Of a velocity (3,) [m/s]: scaled and turned."""
        a, b, c = self.scale
        return rotate(self.rotation, (a * v[0], b * v[1], c * v[2]))

    def pull_force(self, force: Sequence[float]) -> Vector:
        """Back from the client's side: a force (3,) [N] turns, and is mirrored where the scale mirrors, but a newton
        stays a newton."""
        x, y, z, w = self.rotation
        f = rotate((-x, -y, -z, w), force)
        a, b, c = (1.0 if one > 0.0 else -1.0 for one in self.scale)
        return (a * f[0], b * f[1], c * f[2])

    def push_force(self, force: Sequence[float]) -> Vector:
        """To the client's side: the reverse of `pull_force` [N]."""
        a, b, c = (1.0 if one > 0.0 else -1.0 for one in self.scale)
        return rotate(self.rotation, (a * force[0], b * force[1], c * force[2]))

    def as_json(self) -> dict[str, Any]:
        """As that service writes it."""
        return {
            "position": dict(zip("xyz", self.position, strict=True)),
            "rotation": dict(zip("xyzw", self.rotation, strict=True)),
            "scale": dict(zip("xyz", self.scale, strict=True)),
        }


IDENTITY = Transform()


@dataclass(frozen=True)
class Basis:
    """The client's axis i is the service's axis `axes[i]`, with the sign `signs[i]`; written as `permutation`."""

    permutation: str = "XYZ"
    axes: tuple[int, int, int] = (0, 1, 2)
    signs: Vector = (1.0, 1.0, 1.0)

    def name_axes(self, v: Sequence[float]) -> Vector:
        """`v` (3,) in the client's axes, in its own unit [any]."""
        (i, j, k), (a, b, c) = self.axes, self.signs
        return (a * v[i], b * v[j], c * v[k])

    def undo(self, v: Sequence[float]) -> Vector:
        """`v` (3,) of the client in the service's axes, in its own unit [any]."""
        found = [0.0, 0.0, 0.0]
        for axis, sign, value in zip(self.axes, self.signs, v, strict=True):
            found[axis] = sign * value
        return (found[0], found[1], found[2])

    @property
    def hand(self) -> float:
        """1 where the client's axes are right-handed, −1 where they are not."""
        even = self.axes in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
        return (1.0 if even else -1.0) * self.signs[0] * self.signs[1] * self.signs[2]

    def name_turn(self, q: Quaternion) -> Quaternion:
        """The orientation `q` (x, y, z, w) in the client's axes: a turn's axis is mirrored with them."""
        x, y, z = self.name_axes(q[:3])
        return (self.hand * x, self.hand * y, self.hand * z, q[3])

    def name_transform(self, transform: Transform) -> Transform:
        """`transform` of the device's own frame, in the client's axes."""
        i, j, k = self.axes
        scale = (transform.scale[i], transform.scale[j], transform.scale[k])
        return Transform(self.name_axes(transform.position), self.name_turn(transform.rotation), scale)


def parse_basis(text: object) -> Basis:
    """A basis such as "XZY" or "X-YZ". Raises InputError for what is no permutation of X, Y, Z.

    >>> parse_basis("X-YZ").name_axes((1.0, 2.0, 3.0))
    (1.0, -2.0, 3.0)
    """
    if not isinstance(text, str) or len(text) > 12:
        raise InputError(
            "a basis must be a permutation of X, Y and Z, each optionally preceded by + or -, such as 'XZY'"
        )
    axes, signs, sign = list[int](), list[float](), 1.0
    for letter in text.upper():
        if letter in "+-":
            sign = -1.0 if letter == "-" else 1.0
        else:
            axes.append("XYZ".find(letter))
            signs.append(sign)
            sign = 1.0
    if sorted(axes) != [0, 1, 2]:
        raise InputError(f"a basis names each of X, Y and Z once, such as 'XZY'; got '{text}'")
    return Basis(text.upper(), (axes[0], axes[1], axes[2]), (signs[0], signs[1], signs[2]))


def parse_transform(found: object, before: Transform = IDENTITY) -> Transform:
    """A transform as that service writes it; what is missing stays as `before`. Raises InputError for what cannot be:
    numbers that are not finite, a rotation of length 0, a scale of 0."""
    if isinstance(found, Mapping) and isinstance(found.get("transform"), Mapping):
        found = found["transform"]
    if not isinstance(found, Mapping):
        raise InputError("a transform is an object with position, rotation and scale")
    position = _numbers(found.get("position"), "xyz", before.position, "position")
    rotation = _numbers(found.get("rotation"), "xyzw", before.rotation, "rotation")
    scale = _numbers(found.get("scale"), "xyz", before.scale, "scale")
    length = sqrt(sum(one * one for one in rotation))
    if length < 1e-6:
        raise InputError("a rotation is a quaternion {x, y, z, w} that is not zero")
    if any(abs(one) < 1e-3 for one in scale):
        raise InputError("a scale is 0.001 or more along each axis, or -0.001 or less")
    x, y, z, w = (one / length for one in rotation)
    return Transform((position[0], position[1], position[2]), (x, y, z, w), (scale[0], scale[1], scale[2]))


def _numbers(found: object, names: str, before: Sequence[float], what: str) -> list[float]:
    if found is None:
        return list(before)
    if what == "scale" and isinstance(found, int | float) and not isinstance(found, bool):
        found = dict.fromkeys(names, found)
    if isinstance(found, Sequence) and not isinstance(found, str) and len(found) == len(names):
        found = dict(zip(names, found, strict=True))
    if not isinstance(found, Mapping):
        raise InputError(f"{what} is an object with {', '.join(names)}")
    numbers = [found.get(name, old) for name, old in zip(names, before, strict=True)]
    for one in numbers:
        if isinstance(one, bool) or not isinstance(one, int | float) or not -_FARTHEST <= one <= _FARTHEST:
            raise InputError(f"{what} has finite numbers, at most {_FARTHEST:g} in size")
    found = [float(one) for one in numbers]
    assert all(map(isfinite, found))
    return found
