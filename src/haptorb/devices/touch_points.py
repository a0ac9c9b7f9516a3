"""Points on a device that a person can touch with the tool's tip, with known positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, final

import numpy as np
from annotated_types import Len
from pydantic import model_validator

from haptorb.arrays import Array
from haptorb.devices import schema as m
from haptorb.devices.schema import Name, Point, Section

__all__ = ["Marks", "MarksSection"]

_MIN_SPREAD_M = 1e-3  #: marks nearer to a common line than this cannot hold a frame [m]


@final
@dataclass(frozen=True)
class Marks:
    """Engraved dots, by name; what lies in one of them is at its place and can only turn."""

    names: tuple[str, ...]
    positions: Array  #: (k, 3) of each dot's bottom, stator frame [m]


class MarksSection(Section):
    """[marks]"""

    names: Annotated[
        tuple[Name, ...],
        Len(3, 100),
        m.Meaning("name of each mark"),
        m.Form("3 to 100, spelled as name, all different"),
    ]
    positions: Annotated[
        tuple[Point, ...],
        Len(3, 100),
        m.Meaning("bottom of each mark's dot, stator frame, one per name"),
        m.Form("3 to 100 positions x, y, z, not inside the dome and not on one line"),
    ]

    @model_validator(mode="after")
    def _check_marks(self) -> MarksSection:
        if len(self.names) != len(self.positions):
            raise ValueError(f"has {len(self.names)} names but {len(self.positions)} positions")
        if len(set(self.names)) != len(self.names):
            raise ValueError("has a duplicate name")
        places = np.array(self.positions)
        spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if spread[1] < _MIN_SPREAD_M:
            raise ValueError("must not lie on one line: a frame could turn about it")
        return self

    def build(self) -> Marks:
        """As the device has it."""
        return Marks(self.names, np.array(self.positions))
