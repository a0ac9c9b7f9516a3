"""Pose and motion of the mover: the state that worlds, estimators and devices share."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptorb.display.html import facts_html
from haptorb.display.quantity_text import format_number, format_vector
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, check_finite, rotation, vectors
from haptorb.numerics.record import record

__all__ = ["State", "rotation_to_axis"]


def rotation_to_axis(axis: ArrayLike) -> Array:
    """The rotation R_SR, shape (3, 3), that turns the mover's z axis to `axis` by the smallest angle.

    Raises InputError for the zero vector.

    >>> bool((rotation_to_axis((0, 0, 2)) == np.eye(3)).all())
    True
    """
    z = vectors(axis, "axis")
    length = float(np.linalg.norm(z))
    if length == 0.0:
        raise InputError("axis must not be the zero vector: it has no direction")
    x, y, c = z / length
    if c < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    k = 1.0 / (1.0 + c)
    return np.array([[1 - k * x * x, -k * x * y, x], [-k * x * y, 1 - k * y * y, y], [-x, -y, c]])


@record
class State:
    """Pose and motion of the mover (a tool's magnet, or a rotor) in the stator frame S.

    t      time [s]
    R_SR   (3, 3) turns mover vectors into stator vectors; a tool's magnetic moment lies along the mover's +z
    p      (3,) position of the mover's origin [m]: a tool's magnet centre; zero for a rotor
    w      (3,) angular velocity [rad/s], stator frame
    v      (3,) velocity of p [m/s], stator frame
    """

    t: float
    R_SR: Array
    p: Array
    w: Array
    v: Array

    @classmethod
    def at(
        cls,
        position: ArrayLike,
        axis: ArrayLike | None = None,
        *,
        R_SR: ArrayLike | None = None,
        v: ArrayLike = (0.0, 0.0, 0.0),
        w: ArrayLike = (0.0, 0.0, 0.0),
        t: float = 0.0,
    ) -> State:
        """A tool at `position` (3,) [m], its axis radial unless `axis` (3,) or `R_SR` (3, 3) is given.

        Raises InputError for other shapes, for both orientations at once, and for the centre without one.

        >>> State.at((0.0, 0.05, 0.0)).axis.tolist()
        [0.0, 1.0, 0.0]
        """
        p = vectors(position, "position")
        if p.shape != (3,):
            raise InputError(f"position must have shape (3,); got {p.shape}")
        if axis is not None and R_SR is not None:
            raise InputError("give the orientation as axis or as R_SR, not both")
        if R_SR is not None:
            R = rotation(R_SR, "R_SR")
        elif axis is None and not p.any():
            raise InputError("at the centre no direction is radial: give axis or R_SR")
        else:
            R = rotation_to_axis(p if axis is None else axis)
        return cls(float(check_finite(t, "t")), R, p, vectors(w, "w"), vectors(v, "v"))

    @classmethod
    def from_rotation(cls, R_SR: ArrayLike, *, w: ArrayLike = (0.0, 0.0, 0.0), t: float = 0.0) -> State:
        """A rotor turned by `R_SR` (3, 3) about the motor's centre, turning with `w` (3,) [rad/s].

        >>> State.from_rotation(np.eye(3)).p.tolist()
        [0.0, 0.0, 0.0]
        """
        return cls(float(check_finite(t, "t")), rotation(R_SR, "R_SR"), np.zeros(3), vectors(w, "w"), np.zeros(3))

    def __repr__(self) -> str:
        """Place and axis, and on a second line the motion, if there is any."""
        facts = dict(self._list_facts())
        still = not (self.v.any() or self.w.any())
        motion = "" if still else f"\n v {facts['velocity v']}, w {facts['angular velocity w']}"
        return f"<State at t = {facts['time t']}: p {facts['position p']}, axis {facts['axis']}{motion}>"

    def _repr_html_(self) -> str:
        return facts_html("State of the mover", self._list_facts())

    def _list_facts(self) -> list[tuple[str, str]]:
        """Names and figures with units."""
        return [
            ("time t", f"{format_number(self.t, 6)} s"),
            ("position p", format_vector(self.p, "m", 4)),
            ("axis", f"({', '.join(f'{x + 0.0:.3f}' for x in self.axis.round(3).tolist())})"),
            ("velocity v", format_vector(self.v, "m/s")),
            ("angular velocity w", format_vector(self.w, "rad/s")),
        ]

    @property
    def axis(self) -> Array:
        """(3,) the mover's z axis in the stator frame: the direction of a tool's moment, or of a handle."""
        return self.R_SR[:, 2]

    @property
    def distance(self) -> float:
        """Distance of p from the device's centre [m]."""
        x, y, z = self.p
        return float((x * x + y * y + z * z) ** 0.5)
