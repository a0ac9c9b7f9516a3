"""Bai 2012, Table 2: twelve pairs of coils in series, "symmetrical about the motor center" (errata E3, E4)."""

from __future__ import annotations

import numpy as np

from haptorb.apps.reproduce.citation import Citation
from haptorb.apps.reproduce.item import Item
from haptorb.apps.reproduce.registry import Report
from haptorb.devices.motor.api import motor, torque_characteristic
from haptorb.devices.motor.validation import workspace_sample
from haptorb.numerics.arrays import Array

__all__ = ["PAIRS", "items"]

_AT = Citation("bai2012", "t2", "Table 2")
#: as printed, u_1 … u_12
PAIRS = ((1, 13), (2, 14), (3, 15), (4, 16), (5, 9), (6, 10), (7, 11), (8, 12), (17, 21), (18, 22), (19, 23), (20, 24))


def items(report: Report) -> tuple[tuple[Item, ...], None]:
    """The angle between the axes of each pair, and what each way of wiring and polarizing is worth."""
    device, in_phase = motor("pmsm"), motor("pmsm-in-phase")
    u = device.electromagnets.directions
    found = [
        _AT.item("channels", "electrical inputs", 12, device.channels, where="§3"),
        _AT.claim("wired", "coils that share a channel with the one that Table 2 names", 24,
                 2 * sum(_are_paired(device.groups, i, j) for i, j in PAIRS)),
    ]  # fmt: skip
    for n, (i, j) in enumerate(PAIRS):
        between = np.degrees(np.arccos(np.clip(u[i - 1] @ u[j - 1], -1, 1)))
        found.append(
            _AT.claim(f"u{n + 1}", f"u_{n + 1}: angle between the axes of EM{i} and EM{j}", 180.0, between, "°", 1e-5,
                     "opposite", erratum="E3" if n < 8 else "")
        )  # fmt: skip
    R = workspace_sample(device.workspace_tilt, 5, 24)
    single = torque_characteristic(device, R)
    report(0.5)
    phase = torque_characteristic(in_phase, R)
    aiding, opposed = (np.array([_pair(i, j, sign) for i, j in PAIRS]).T for sign in (1.0, -1.0))
    best = _least(single @ opposed)
    found += [
        _AT.note("aiding", "smallest singular value, i₁ = i₁₃ with the same radial sense, checkerboard magnets",
                 _least(single @ aiding), "N·m/A", "zero: E4; the motor would heat and not turn"),
        _AT.note("opposed", "the same, second coil of each pair wound the other way (the default)", best, "N·m/A"),
        _AT.claim("ratio", "that over the one for rings in step and coils aiding: two readings, both turn", 1.0,
                 best / _least(phase @ aiding), "1", 0.2, "the value depends on how finely the workspace is sampled",
                 erratum="E4", corrected=1.55),
    ]  # fmt: skip
    report(1.0)
    return tuple(found), None


def _are_paired(groups: Array, i: int, j: int) -> bool:
    return bool((groups[i - 1] * groups[j - 1]).any())


def _pair(i: int, j: int, sign: float) -> Array:
    column = np.zeros(24)
    column[i - 1], column[j - 1] = 1.0, sign
    return column


def _least(K: Array) -> float:
    return float(np.linalg.svd(K, compute_uv=False)[:, 2].min())
