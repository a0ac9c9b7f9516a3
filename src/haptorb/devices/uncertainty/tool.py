"""Standard uncertainties of a spherical electromagnet: [uncertainty] of its file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from haptorb.devices.schema import key as m
from haptorb.devices.schema import quantity as q
from haptorb.devices.uncertainty.common import ChainUncertainty, Share

__all__ = ["ToolUncertainty"]


class ToolUncertainty(ChainUncertainty):
    """[uncertainty] of a spherical electromagnet; `ToolUncertainty()` has the defaults.

    >>> ToolUncertainty().place, ToolUncertainty(place="0.1 mm").place
    (0.0003, 0.0001)
    """

    current_offset: Annotated[
        q.Current,
        m.Meaning("offset of each current sensor"),
        Field(default="5 mA", validate_default=True, ge=0, le=10),
    ]
    remanence: Annotated[
        Share, m.Meaning("remanence of the tool's magnet, relative"), Field(default=0.012, validate_default=True)
    ]
    moments: Annotated[
        Share,
        m.Meaning("each component of a coil's moment per ampere, as a share of that moment; a calibration replaces it"),
        Field(default=0.01, validate_default=True),
    ]
    place: Annotated[
        q.Length,
        m.Meaning("tracked position of the tool's magnet, along each axis, including the tracker's frame"),
        Field(default="0.3 mm", validate_default=True, ge=0, le=0.005),
    ]
    axis: Annotated[
        q.Angle,
        m.Meaning("tracked direction of the tool, about each axis across it"),
        Field(default="0.3 deg", validate_default=True, ge=0, le=0.2),
    ]
    core_place: Annotated[
        q.Length,
        m.Meaning("position of core and coils in the stator's frame, along each axis"),
        Field(default="0.1 mm", validate_default=True, ge=0, le=0.005),
    ]
    core_radius: Annotated[
        q.Length,
        m.Meaning("radius of the core"),
        Field(default="0.05 mm", validate_default=True, ge=0, le=0.002),
    ]
