"""Bai 2012, Table 2: twelve pairs of coils in series, "symmetrical about the motor center" (errata E3, E4)."""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.api import motor, torque_characteristic
from haptorb.devices.loader import load
from haptorb.devices.motor import SphericalMotor, workspace_sample
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.entry import Entry, read_entry
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Report

__all__ = ["PAIRS", "items"]

_AT = Citation("bai2012", "t2", "Table 2")
#: as printed, u_1 … u_12
PAIRS = ((1, 13), (2, 14), (3, 15), (4, 16), (5, 9), (6, 10), (7, 11), (8, 12), (17, 21), (18, 22), (19, 23), (20, 24))


def items(report: Report) -> tuple[tuple[Item, ...], None]:
    """The angle between the axes of each pair, and what each way of wiring and polarizing is worth."""
    device, in_phase = motor("pmsm"), motor("pmsm-in-phase")
    printed = motor(load("pmsm-printed-table", override=True))
    found = [
        _AT.item("channels", "electrical inputs", 12, read_entry(device, "channels"), where="§3"),
        _AT.item("wired", "pairs of coils that share a channel", 12,
                 Entry(sum(_are_paired(device.groups, i, j) for i, j in PAIRS), "pmsm: wiring of the pairs")),
        _AT.compare("opposite", "least angle between the axes of a pair, coils placed by E3 ('symmetrical about the "
                 "motor center')", 180.0, _find_least_angle(device), "°", 1e-5, "opposite", erratum="E3"),
        _AT.claim("opposite-printed", "the same with the printed longitudes", 180.0, _find_least_angle(printed), "°",
                 1e-5, "1–8 at 45°(j − 1), 9–16 at 45°(j − 9) + 22.5°: by spherical trigonometry", erratum="E3",
                 corrected=_separate_by_trigonometry(22.5), where="Table A.1"),
    ]  # fmt: skip
    R = workspace_sample(device.workspace_tilt, 5, 24)
    single = torque_characteristic(device, R)
    report(0.5)
    phase = torque_characteristic(in_phase, R)
    aiding, opposed = (np.array([_pair(i, j, sign) for i, j in PAIRS]).T for sign in (1.0, -1.0))
    best = _least(single @ opposed)
    found += [
        _AT.note("aiding", "smallest singular value, i₁ = i₁₃ with the same radial sense, checkerboard magnets",
                 _least(single @ aiding), "N·m/A", "zero: E4; the motor would heat and not turn"),
        _AT.note("opposed-in-step", "the same, second coil of each pair wound the other way, rings in step",
                 _least(phase @ opposed), "N·m/A", "zero as well: E4"),
        _AT.note("opposed", "the same, second coil of each pair wound the other way, checkerboard (the default)", best,
                 "N·m/A"),
        _AT.note("ratio", "that over the one for rings in step and coils aiding: two readings, both turn",
                 best / _least(phase @ aiding), "1", "depends on how finely the workspace is sampled",
                 erratum="E4"),
    ]  # fmt: skip
    report(1.0)
    return tuple(found), None


def _find_least_angle(device: SphericalMotor) -> float:
    """Between the axes of the two coils of a pair [°]."""
    u = device.electromagnets.directions
    cosines = [u[i - 1] @ u[j - 1] for i, j in PAIRS]
    return float(np.degrees(np.arccos(np.clip(max(cosines), -1.0, 1.0))))


def _separate_by_trigonometry(shift: float, latitude: float = 26.0) -> float:
    """Angle [°] between (−26°, φ) and (26°, φ + 180° + `shift`)."""
    sine, cosine = np.sin(np.radians(latitude)), np.cos(np.radians(latitude))
    return float(np.degrees(np.arccos(-(sine**2) + cosine**2 * np.cos(np.radians(180.0 + shift)))))


def _are_paired(groups: Array, i: int, j: int) -> bool:
    return bool((groups[i - 1] * groups[j - 1]).any())


def _pair(i: int, j: int, sign: float) -> Array:
    column = np.zeros(24)
    column[i - 1], column[j - 1] = 1.0, sign
    return column


def _least(K: Array) -> float:
    return float(np.linalg.svd(K, compute_uv=False)[:, 2].min())
