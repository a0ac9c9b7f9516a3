"""The ways of knowing where a spherical electromagnet's tool is, by name."""

from __future__ import annotations

from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.sensing.estimator import Estimator, EstimatorChoice, EstimatorSettings, tracker_only
from haptorb.sensing.tool.tool_position import IN_TURNS, HallTracker

__all__ = ["tool_estimators"]


def tool_estimators(device: SphericalElectromagnet) -> dict[str, EstimatorChoice]:
    """Name → choice for `device`, the default first; "hall" where it has sensors enough."""
    found = tracker_only(device)
    if device.sensors > 1:
        found["hall"] = EstimatorChoice(_hall, axes=3)
    return found


def _hall(device: SphericalElectromagnet, settings: EstimatorSettings) -> Estimator:
    model, offsets = settings.model, settings.offsets
    if settings.in_turns:
        return HallTracker(device, model, offsets=offsets, bandwidth=IN_TURNS)
    return HallTracker(device, model, offsets=offsets)
