"""Standard uncertainties of a coil array: [uncertainty] of its file. How its coils are built is in [tolerance]."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from haptorb.devices.schema import key as m
from haptorb.devices.schema import quantity as q
from haptorb.devices.uncertainty.common import ChainUncertainty, Share

__all__ = ["ArrayUncertainty"]


class ArrayUncertainty(ChainUncertainty):
    """[uncertainty] of a coil array; `ArrayUncertainty()` has the defaults.

    >>> ArrayUncertainty().place
    0.0003
    """

    current_offset: Annotated[
        q.Current,
        m.Meaning("offset of each current sensor"),
        Field(default="5 mA", validate_default=True, ge=0, le=10),
    ]
    remanence: Annotated[
        Share, m.Meaning("remanence, common to all magnets, relative"), Field(default=0.012, validate_default=True)
    ]
    place: Annotated[
        q.Length,
        m.Meaning("tracked position of the tool, along each axis, including the tracker's frame"),
        Field(default="0.3 mm", validate_default=True, ge=0, le=0.005),
    ]
    axis: Annotated[
        q.Angle,
        m.Meaning("tracked orientation of the tool, about each axis"),
        Field(default="0.3 deg", validate_default=True, ge=0, le=0.2),
    ]
