"""What the coils can do at a pose: wrench per ampere, and the wrench that is there without any current."""

from __future__ import annotations

from haptorb.numerics.arrays import Array
from haptorb.numerics.record import record

__all__ = ["WrenchMap"]


@record
class WrenchMap:
    """Wrench on the mover, in the stator frame, torque about the mover's origin p.

    matrix    (6, m) force [N/A] above torque [N·m/A], one column per channel
    passive   (6,) wrench at zero current [N, N·m]: what a soft core or a regulator does by itself
    """

    matrix: Array
    passive: Array

    @property
    def force(self) -> Array:
        """(3, m) force per current [N/A]."""
        return self.matrix[:3]

    @property
    def torque(self) -> Array:
        """(3, m) torque per current [N·m/A]: a motor's torque characteristic K, Bai 2012 eq. (2)."""
        return self.matrix[3:]

    def wrench(self, currents: Array) -> Array:
        """(6,) the wrench that `currents` (m,) [A] give, the passive part included."""
        wrench: Array = self.matrix @ currents + self.passive
        return wrench
