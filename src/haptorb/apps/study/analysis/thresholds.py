"""Thresholds of adaptive procedures, by condition and participant."""

from __future__ import annotations

from haptorb.apps.asking.procedure import Procedure

__all__ = ["find_thresholds"]


def find_thresholds(procedures: dict[str, Procedure]) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    for code, procedure in procedures.items():
        for part in getattr(procedure, "parts", ()):
            threshold = getattr(part, "threshold", None)
            if threshold is not None and part.prompt is None:
                found.setdefault(part.condition, {})[code] = float(threshold)
    return found
