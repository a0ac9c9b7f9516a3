"""What the file of a spherical electromagnet may say of its windings."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from annotated_types import Len
from pydantic import Field

from haptorb.devices.electromagnet.windings import Windings
from haptorb.devices.schema import key as m
from haptorb.devices.schema import quantity as q
from haptorb.devices.schema.sections import Positive, Section

__all__ = ["WindingsSection"]

_MOST_FILL = 0.9  #: round wires side by side fill 0.907


class WindingsSection(Section):
    """[windings]"""

    turns: Annotated[
        tuple[Annotated[q.Number, Positive], ...], Len(3, 3), m.Meaning("turns of the coils about x, y and z")
    ]
    inner_radius: Annotated[
        tuple[Annotated[q.Length, Positive], ...],
        Len(3, 3),
        m.Meaning("inner radius of each winding"),
        m.Form("above core_radius"),
    ]
    outer_radius: Annotated[
        tuple[Annotated[q.Length, Positive], ...],
        Len(3, 3),
        m.Meaning("outer radius of each winding"),
        m.Form("between inner_radius and dome.radius"),
    ]
    length: Annotated[
        tuple[Annotated[q.Length, Positive], ...], Len(3, 3), m.Meaning("length of each winding along its own axis")
    ]
    fill: Annotated[
        q.Number | None,
        Field(gt=0, le=_MOST_FILL),
        m.Meaning(
            "fill factor of copper in the windings' cross-section; if given, the windings instead of the file "
            "determine moments, "
            "resistances, inductances and the windings' heat capacity"
        ),
        m.Without("those of the file"),
    ] = None

    def build(self) -> Windings:
        """As the device has it."""
        return Windings(*(np.array(part) for part in (self.turns, self.inner_radius, self.outer_radius, self.length)))
