"""A driver that plays what another one had read: the same samples, the same answers, tick after tick."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np

from haptorb.control.protection.trip import CoilState
from haptorb.errors import DriverError
from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.driver import Driver
from haptorb.runtime.tick.tick_log import TickFailure
from haptorb.sensing.sample import Pose, Sample

__all__ = ["PlayedDriver"]

_READ, _WRITE, _ENGAGE = int(TickFailure.READ), int(TickFailure.WRITE), int(TickFailure.ENGAGE)
_MOST = 2.0**31  #: more than all failures together
_FAILED = "the driver failed in the recording"


@final
class PlayedDriver(Driver):
    """Answers what stands in the block of ticks that `load` was given last, for the tick that `go_to` chose."""

    name, simulated = "played", True

    def __init__(self, sensors: int) -> None:
        self._sensors = sensors
        self._samples: list[Sample] = []
        self._duties: list[Array] = []
        self._truths: list[Array] = []
        self._targets: list[Array] = []
        self._coils: list[CoilState] = []
        self._failures: list[int] = []
        self._at = 0

    def load(self, block: Mapping[str, Array], t: Array) -> None:
        """The next ticks: field → (n, width), each in its unit [SI], at the times `t` (n,) [s] of the replay."""
        sensors = self._sensors
        n = len(t)

        def rows(name: str) -> Array:
            return np.ascontiguousarray(block[name], dtype=np.float64)

        R = rows("pose_r").reshape(n, 3, 3)
        field = rows("field").reshape(n, sensors, 3) if sensors and "field" in block else np.zeros((n, sensors, 3))
        with np.errstate(invalid="ignore"):  # in a damaged file
            waited = t - block["t"][:, 0]  # 0, but where the replay has another rate
        ages = rows("currents_age")[:, 0] + waited, rows("field_age")[:, 0] + waited
        poses = map(
            Pose, block["pose_t"][:, 0].tolist(), R, rows("pose_p"), rows("pose_w"), rows("pose_v"),
            (block["pose_valid"][:, 0] == 1.0).tolist(),
        )  # fmt: skip
        self._samples = list(
            map(Sample, t.tolist(), rows("currents"), rows("boundary"), field, poses, *(age.tolist() for age in ages))
        )
        self._duties = list(rows("duties"))
        self._truths = list(rows("given"))
        self._targets = list(np.concatenate((rows("target"), rows("target_q")), axis=1))
        codes = block["coil_state"][:, 0].tolist()
        states = {code: _coil_state(code) for code in set(codes)}
        self._coils = [states[code] for code in codes]
        failures = np.nan_to_num(block["failures"][:, 0], posinf=0.0, neginf=0.0)
        self._failures = np.clip(failures, 0.0, _MOST).astype(int).tolist()
        self._at = 0

    def go_to(self, number: int) -> None:
        """The tick `number` of the block, from 0 on, is next."""
        self._at = number

    def open(self) -> None:
        """Nothing is to be done."""

    def close(self) -> None:
        """Nothing is to be done."""

    def read(self, now: float) -> Sample:
        """The tick's sample. Raises DriverError where the recorded driver did."""
        if self._failures[self._at] & _READ:
            raise DriverError(_FAILED)
        return self._samples[self._at]

    def write(self, duties: Array) -> Array:
        """(m,) the duties [1] that were applied. Raises DriverError where the recorded driver did."""
        if self._failures[self._at] & _WRITE:
            raise DriverError(_FAILED)
        return self._duties[self._at]

    def engage(self) -> None:
        """Raises DriverError where the recorded driver did."""
        if self._failures[self._at] & _ENGAGE:
            raise DriverError(_FAILED)

    @property
    def coil_state(self) -> CoilState:
        """As it was."""
        return self._coils[self._at]

    def truth(self) -> Array:
        """(6,) what the recorded driver knew of the wrench [N, N·m]; NaN where it knew nothing."""
        return self._truths[self._at]

    def target(self) -> Array:
        """(7,) where the hand wanted the mover: position [m] and quaternion."""
        return self._targets[self._at]


def _coil_state(code: float) -> CoilState:
    try:
        return CoilState(int(code))
    except (ValueError, OverflowError):
        return CoilState.UNKNOWN
