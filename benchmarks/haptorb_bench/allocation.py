"""Torque to currents within limits: this library's dual Newton method and DAQP on the same problems."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from haptorb.arrays import Array
from haptorb.control.allocation import MinimumPowerAllocator
from haptorb.devices.api import motor, torque_characteristic
from haptorb.devices.base import WrenchMap
from haptorb.devices.motor import workspace_sample
from haptorb_bench.contest import measure_fastest
from haptorb_bench.result import Metric

__all__ = ["rows"]

_KINDS = (("well inside the limits", 0.3), ("at the limits", 1.0))


def rows(effort: float, notify: Callable[[str], None]) -> list[Metric]:
    """Time per problem, twelve channels, one sweep over 100 of them; and how far the two answers are apart."""
    device = motor("pmsm")
    R = workspace_sample(device.workspace_tilt, 5, 4)
    maps = torque_characteristic(device, R, grouped=True)
    limit = device.coils.current_limit
    allocator = MinimumPowerAllocator(limit)
    out = []
    for kind, share in _KINDS:
        notify(kind)
        problems = [_problem(K, limit, share, n) for n, K in enumerate(maps)]

        def ours(problems: list[tuple[WrenchMap, Array]] = problems) -> None:
            for wrench_map, wrench in problems:
                allocator.allocate(wrench_map, wrench)

        own = 1e6 * measure_fastest(ours, len(problems), budget=effort)
        peer = apart = None
        if find_spec("daqp") is not None:
            theirs = [_daqp(wrench_map.matrix[3:], wrench[3:], limit) for wrench_map, wrench in problems]
            peer = 1e6 * measure_fastest(lambda theirs=theirs: [one() for one in theirs], len(theirs), budget=effort)  # type: ignore[misc]
            apart = max(
                float(np.abs(allocator.allocate(*problem).currents - one()).max())
                for problem, one in zip(problems, theirs, strict=True)
            )
        note = "DAQP is not installed" if apart is None else f"answers differ by {apart:.0e} A at most"
        out.append(
            Metric("allocation", f"least-power currents, 12 channels, {kind}", own, "µs", "DAQP", peer, note=note)
        )
    return out


def _problem(K: Array, limit: Array, share: float, number: int) -> tuple[WrenchMap, Array]:
    """A torque that some currents within `share` of the limits give, all at an end of them for share 1."""
    rng = np.random.default_rng(number)
    way = rng.normal(size=3)
    currents = 0.98 * share * limit * np.sign(K.T @ way)
    wrench = np.zeros(6)
    wrench[3:] = K @ currents
    return WrenchMap(np.vstack([np.zeros((3, K.shape[1])), K]), np.zeros(6)), wrench


def _daqp(K: Array, torque: Array, limit: Array) -> Callable[[], Array]:
    """DAQP on the same: least ½ i² with K i = torque within ± limit; built once, solved when called."""
    import daqp

    m = K.shape[1]
    H, f, scale = np.eye(m), np.zeros(m), np.abs(K).max()
    sense = np.r_[np.zeros(m), np.full(3, 5)].astype(np.int32)  # 5: an equality
    A, upper, lower = K / scale, np.r_[limit, torque / scale], np.r_[-limit, torque / scale]

    def solve() -> Array:
        answer: Array = daqp.solve(H, f, A, upper, lower, sense, primal_tol=1e-10, dual_tol=1e-12)[0]
        return answer

    return solve
