"""What differs between kinds of device: functions that a kind of your own implements, and what they return.

Each function is a `functools.singledispatch` function on the class of the device. How to add a kind of device:
`docs/how-to/device.md`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.lazy_names import lazy_names

if TYPE_CHECKING:
    from haptorb.analysis.coupling import HeldMover, hold_mover
    from haptorb.analysis.error_budget import Component, ErrorModel
    from haptorb.analysis.error_models import error_model
    from haptorb.analysis.workspace import Workspace, workspace
    from haptorb.cli.card import Card, Curve, Quantity
    from haptorb.cli.cards import card
    from haptorb.cli.check_world import boundary
    from haptorb.control.allocation import Allocation, Allocator, LeastSquaresAllocator, WrenchChoice
    from haptorb.control.linkage import Linkage, RenderedWrench, make_linkage
    from haptorb.control.registry import describe_choice, make_allocator, make_choice
    from haptorb.estimation.registry import list_estimators
    from haptorb.estimation.types import EstimatorChoice, EstimatorSettings
    from haptorb.simulation.hand_motion import GuidedMotion, guide_hand
    from haptorb.simulation.registry import simulate
    from haptorb.web.session import describe_parts, describe_scene

__all__ = [
    "Allocation",
    "Allocator",
    "Card",
    "Component",
    "Curve",
    "ErrorModel",
    "EstimatorChoice",
    "EstimatorSettings",
    "GuidedMotion",
    "HeldMover",
    "LeastSquaresAllocator",
    "Linkage",
    "Quantity",
    "RenderedWrench",
    "Workspace",
    "WrenchChoice",
    "boundary",
    "card",
    "describe_choice",
    "describe_parts",
    "describe_scene",
    "error_model",
    "guide_hand",
    "hold_mover",
    "list_estimators",
    "make_allocator",
    "make_choice",
    "make_linkage",
    "simulate",
    "workspace",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "haptorb.analysis.coupling": "HeldMover hold_mover",
        "haptorb.analysis.error_budget": "Component ErrorModel",
        "haptorb.analysis.error_models": "error_model",
        "haptorb.analysis.workspace": "Workspace workspace",
        "haptorb.cli.card": "Card Curve Quantity",
        "haptorb.cli.cards": "card",
        "haptorb.cli.check_world": "boundary",
        "haptorb.control.allocation": "Allocation Allocator LeastSquaresAllocator WrenchChoice",
        "haptorb.control.linkage": "Linkage RenderedWrench make_linkage",
        "haptorb.control.registry": "describe_choice make_allocator make_choice",
        "haptorb.estimation.registry": "list_estimators",
        "haptorb.estimation.types": "EstimatorChoice EstimatorSettings",
        "haptorb.simulation.hand_motion": "GuidedMotion guide_hand",
        "haptorb.simulation.registry": "simulate",
        "haptorb.web.session": "describe_parts describe_scene",
    },
)
