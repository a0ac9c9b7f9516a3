"""Standard uncertainties of a spherical motor: [uncertainty] of its file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from haptorb.devices.schema import key as m
from haptorb.devices.schema import quantity as q
from haptorb.devices.uncertainty.common import ChainUncertainty, Share

__all__ = ["MotorUncertainty"]


class MotorUncertainty(ChainUncertainty):
    """[uncertainty] of a spherical motor; `MotorUncertainty()` has the defaults.

    >>> MotorUncertainty().coil
    0.01
    """

    current_offset: Annotated[
        q.Current,
        m.Meaning("offset of each current sensor"),
        Field(default="0.5 mA", validate_default=True, ge=0, le=1),
    ]
    polarization: Annotated[
        Share, m.Meaning("polarization, common to all magnets, relative"), Field(default=0.012, validate_default=True)
    ]
    polarization_spread: Annotated[
        Share, m.Meaning("polarization from magnet to magnet, relative"), Field(default=0.01, validate_default=True)
    ]
    coil: Annotated[
        Share,
        m.Meaning("torque per ampere of each coil, relative: its position, winding and turns"),
        Field(default=0.01, validate_default=True),
    ]
    regulator: Annotated[
        Share, m.Meaning("torque of the regulator, relative"), Field(default=0.03, validate_default=True)
    ]
    weight: Annotated[
        Share,
        m.Meaning("torque of the rotor's weight, relative: its mass times the height of its centre"),
        Field(default=0.02, validate_default=True),
    ]
    axis: Annotated[
        q.Angle,
        m.Meaning("orientation about each axis if measured by a tracker; field sensors have their own errors"),
        Field(default="0.3 deg", validate_default=True, ge=0, le=0.2),
    ]
