"""The last estimate of an estimator, in arrays of fixed size: for its snapshot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap
from haptorb.numerics.state_arrays import StateArray, choose, make_block
from haptorb.sensing.sample import Estimate

__all__ = ["KeptEstimate"]


@final
class KeptEstimate:
    """Room for one estimate of a device with so many `channels`."""

    def __init__(self, channels: int) -> None:
        #: by name; `motion` is place [m], angular velocity [rad/s] and velocity [m/s]
        self.arrays: Mapping[str, StateArray]
        self.arrays, self._cells = make_block(
            {"rotation": (3, 3), "motion": (3, 3), "wrench_map": (6, channels), "passive": (6,), "covariance": (3, 3)},
            estimate=(
                "t", "valid", "age", "oriented", "spin_period", "has_covariance", "strength", "disbelieved", "reversed"
            ),
        )  # fmt: skip
        _, self._turn, motion, self._matrix, self._passive, self._covariance = self.arrays.values()
        self._p, self._w, self._v = motion

    def store(self, estimate: Estimate) -> None:
        """Copy it into the arrays."""
        state, cells = estimate.state, self._cells
        self._turn[:], self._p[:], self._w[:], self._v[:] = state.R_SR, state.p, state.w, state.v
        self._matrix[:], self._passive[:] = estimate.wrench_map.matrix, estimate.wrench_map.passive
        cells[0], cells[1], cells[2], cells[3] = state.t, estimate.valid, estimate.age, estimate.oriented
        cells[4], cells[6], cells[7] = estimate.spin_period, estimate.strength, estimate.disbelieved
        cells[8] = estimate.reversed
        covariance = estimate.covariance
        cells[5] = covariance is not None
        if covariance is not None:
            self._covariance[:] = covariance

    def load(self) -> Estimate:
        """The estimate that the arrays describe. Raises ValueError for numbers that describe none."""
        t, valid, age, oriented, period, has, strength, disbelieved, reversed_ = self._cells
        p, w, v = self._p.copy(), self._w.copy(), self._v.copy()
        return Estimate(
            State(t, self._turn.copy(), p, w, v),
            WrenchMap(self._matrix.copy(), self._passive.copy()),
            bool(valid), age, bool(oriented), period, self._covariance.copy() if has else None, strength,
            choose(disbelieved, 1 << 20), bool(reversed_),
        )  # fmt: skip
