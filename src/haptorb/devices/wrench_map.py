"""The wrench map at a pose: wrench per ampere, and the passive wrench without current."""

from __future__ import annotations

import numpy as np

from haptorb.display.html import facts_html, table_html
from haptorb.display.quantity_text import format_number, format_quantity
from haptorb.numerics.arrays import Array
from haptorb.numerics.record import record

__all__ = ["WrenchMap"]

_NAMES = ("F_x", "F_y", "F_z", "T_x", "T_y", "T_z")


@record
class WrenchMap:
    """Wrench on the mover, in the stator frame, torque about the mover's origin p.

    matrix    (6, m) force [N/A] above torque [N·m/A], one column per channel
    passive   (6,) passive wrench at zero current [N, N·m], of a soft core or a regulator
    """

    matrix: Array
    passive: Array

    def __repr__(self) -> str:
        """Greatest force and torque per ampere over the channels, and what is there at zero current."""
        force, torque = (format_quantity(float(part.max(initial=0.0)), unit) for part, unit in self._sizes())
        still = [format_quantity(float(np.linalg.norm(self.passive[i : i + 3])), u) for i, u in ((0, "N"), (3, "N·m"))]
        return (
            f"<WrenchMap of {self.matrix.shape[1]} channels: up to {force} and {torque}; "
            f"passive {still[0]} and {still[1]}>"
        )

    def _repr_html_(self) -> str:
        """One row per component, one column per channel, the passive wrench last."""
        units = ("mN", "mN", "mN", "mN·m", "mN·m", "mN·m")
        matrix, passive = (np.where(np.abs(a) < 1e-9 * np.abs(a).max(), 0.0, a) for a in (self.matrix, self.passive))
        rows = [
            [f"{name} [{unit}/A]", *map(format_number, [1e3 * x for x in row]), f"{format_number(1e3 * still)} {unit}"]
            for name, unit, row, still in zip(_NAMES, units, matrix.tolist(), passive.tolist(), strict=True)
        ]
        channels = [f"channel {n}" for n in range(1, self.matrix.shape[1] + 1)]
        return facts_html(repr(self)[1:-1], [], table_html(["", *channels, "passive"], rows))

    def _sizes(self) -> tuple[tuple[Array, str], tuple[Array, str]]:
        """(m,) size of each channel's force [N/A], and of its torque [N·m/A]."""
        return (np.linalg.norm(self.force, axis=0), "N/A"), (np.linalg.norm(self.torque, axis=0), "N·m/A")

    @property
    def force(self) -> Array:
        """(3, m) force per current [N/A]."""
        return self.matrix[:3]

    @property
    def torque(self) -> Array:
        """(3, m) torque per current [N·m/A]: a motor's torque characteristic K, Bai 2012 eq. (2)."""
        return self.matrix[3:]

    def wrench(self, currents: Array) -> Array:
        """(6,) the wrench of `currents` (m,) [A], including the passive part."""
        wrench: Array = self.matrix @ currents + self.passive
        return wrench
