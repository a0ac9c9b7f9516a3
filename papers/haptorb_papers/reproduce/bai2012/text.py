"""Bai 2012, title to section 2 and section 4: statements of the prose and of figures without numbers."""

from __future__ import annotations

import math

import numpy as np

from haptorb.devices.api import motor, torque_characteristic
from haptorb.devices.motor import workspace_sample
from haptorb_papers.reproduce.bai2012.field_estimation import compare_rates, find_accumulation
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.entry import read_count, read_entry
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Report

__all__ = ["items"]

_AT = Citation("bai2012", "text", "§1")


def items(report: Report) -> tuple[tuple[Item, ...], None]:
    """Counts, the absence of singularities, and what cannot be checked."""
    device = motor("pmsm")
    R = workspace_sample(device.workspace_tilt, 15, 72)
    least = np.linalg.svd(torque_characteristic(device, R, grouped=True), compute_uv=False)[:, 2]
    direct, by_model, by_table = compare_rates(device)
    report(1.0)
    return (
        _AT.item("electromagnets", "N_s, electromagnets in the stator (Table A.1)", 24,
                 read_count(device, "electromagnets.directions")),
        _AT.item("magnets", "N_r, permanent magnets in the rotor (Table A.1)", 24,
                 read_count(device, "magnets.directions")),
        _AT.item("tilt", "greatest |ψ| and |λ| of the working space", 22.5,
                 read_entry(device, "workspace_tilt", math.degrees(1.0)), "°", where="§2.3"),
        _AT.claim("singularity",
                 "share of those orientations at which the twelve channels turn the rotor about three axes "
                 "('singularity-free')", 1.0, np.mean(least > 1e-3), "1", 0.0, "all of them"),
        _AT.note("weakest", "smallest singular value of the 3 × 12 torque characteristic over them", least.min(),
                 "N·m/A"),
        _AT.exempt("figure-1", "CAD model of the spherical motor", "a drawing; its sizes are those of Table A.1",
                      "Fig. 1"),
        _AT.exempt("figure-2", "frames, and position and torque commands", "a drawing; equations (1), (5) and (6) "
                      "say the same and are checked", "Fig. 2"),
        _AT.exempt("nonmagnetic", "coils without iron, and no magnetic parts except the magnets",
                      "a property of the prototype; the model assumes it", "§2"),
        _AT.claim("accumulation", "'reduces error accumulation': error of the orientation after 200 to 400 estimates "
                 "over what the noise of one reading allows", 1.0, find_accumulation(device), "1", 0.1,
                 "least squares, 0.1 mT of noise; Cramér and Rao's bound of the exact field", where="§1, §4"),
        _AT.note("rate", "'greatly improves the sampling rate': time from a reading to K by the orientation and then "
                 "eq. (9), over that by a direct map, which needs no orientation", by_model / direct, "1",
                 "timed on this machine", "§1, §4"),
        _AT.note("rate-table", "the same with haptorb's table in place of (9)", by_table / direct, "1",
                 "timed on this machine; an orientation costs little", "§1, §4"),
        _AT.exempt("feel", "'offers an intuitive haptic feeling' more than serial mechanisms do",
                      "a statement about people, without a study", "§1, §4"),
        _AT.exempt("sensors-order", "sensor axes (ϑ, φ, r) measure (B_φ, B_θ, B_r)",
                      "one of the two orders is a misprint (E28); ours is ϑ, φ, r for both", "§2"),
    ), None  # fmt: skip
