"""Limits on the force of a device's gripper: magnitude, rate, change of client through zero; off with the coils."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import final

from haptorb.arrays import StateArray, Stateful, make_numbers
from haptorb.devices.base import HANDOVER_TIME_S
from haptorb.devices.gripper import Gripper

__all__ = ["GripperGuard"]


@final
class GripperGuard(Stateful):
    """Force limit of a `gripper`, for ticks `dt` [s] apart, like the guard's limit of a client's force on the mover.

    At most the gripper's maximum force, with a slew rate from that to zero in 20 ms. Another client's force is rendered
    once the previous one has become zero. `gain`, 0 to 1, is the guard's: at zero the force is zero in the same tick.

    >>> guard = GripperGuard(Gripper(0.025, 8.0, 0.1, 0.02, 0.05, 0.2, 1e-5, 0.02, 300.0, 2.0), 1e-3)
    >>> [round(guard.limit(100.0, 1.0, 1.0), 3) for _ in range(3)], guard.limit(100.0, 0.0, 1.0)
    ([0.4, 0.8, 1.2], 0.0)
    """

    def __init__(self, gripper: Gripper, dt: float) -> None:
        self._most, self._step = gripper.force, gripper.force * dt / HANDOVER_TIME_S
        self._force, self._session = 0.0, 0.0
        self._kept = make_numbers("force", "session")

    def state_arrays(self) -> Mapping[str, StateArray]:
        """State: force before the guard's gain [N], and the session of the client that commands it [1]."""
        return {"gripper": self._kept[0]}

    def gather_state(self) -> None:
        """Copy force and session into the state arrays."""
        self._kept[1][0], self._kept[1][1] = self._force, self._session

    def apply_state(self) -> None:
        """Restore force and session from the state arrays."""
        self._force, self._session = self._kept[1]

    def limit(self, wanted: float, gain: float, session: float) -> float:
        """Return the force for this tick [N] if the world requests `wanted` [N], commanded by the client `session`."""
        if gain == 0.0 or not math.isfinite(wanted):  # safety: gripper-off-with-coils
            self._force, self._session = 0.0, session
            return 0.0
        if self._force == 0.0:
            self._session = session
        goal = min(max(wanted, -self._most), self._most) if session == self._session else 0.0  # safety: gripper-clamped
        self._force += min(max(goal - self._force, -self._step), self._step)  # safety: gripper-force-rate
        return gain * self._force
