"""What a device file may say of the heat of all coils together: how they warm each other, and how sure that is."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from pydantic import Field

from haptorb.devices.device import Heat, HeatCoupling
from haptorb.devices.schema import key as m
from haptorb.devices.schema import quantity as q
from haptorb.devices.schema.sections import Positive, Section

__all__ = ["CouplingSection", "ThermalSection"]

_FASTEST = 40.0  #: rate of a coupling that the guard's thermal model can follow [1/s]


class CouplingSection(Section):
    """[thermal.coupling]"""

    core_capacity: Annotated[
        q.HeatCapacity, Positive, m.Meaning("heat capacity of the core or former that lies between the windings")
    ]
    winding_to_core: Annotated[
        tuple[Annotated[q.Conductance, Positive], ...],
        m.Meaning("heat conductance from each winding to the core, one per coil"),
    ]


class ThermalSection(Section):
    """[thermal]"""

    tolerance: Annotated[
        q.Number,
        Field(ge=0, le=0.5),
        m.Meaning(
            "relative tolerance of capacities and conductances of the thermal model; the guard assumes the worst case"
        ),
    ] = 0.0
    coupling: Annotated[
        CouplingSection | None,
        m.Meaning("thermal coupling between the coils"),
        m.Without("none: no thermal coupling"),
    ] = None

    def complete(self, heat: Heat, channels: int) -> Heat:
        """`heat` of so many channels with what this table says; ValueError if it does not fit them."""
        if self.coupling is None:
            return replace(heat, tolerance=self.tolerance)
        count = len(self.coupling.winding_to_core)
        if count != channels:
            raise ValueError(f"thermal.coupling.winding_to_core has {count} values for {channels} coils; give one each")
        coupling = HeatCoupling(self.coupling.core_capacity, self.coupling.winding_to_core)
        rates = {
            "core_capacity": sum(coupling.winding_to_core) / coupling.core_capacity,
            "winding_to_core": max(coupling.winding_to_core) / heat.winding_capacity,
        }
        for key, rate in rates.items():
            if rate > _FASTEST:
                raise ValueError(
                    f"thermal.coupling.{key} gives a time constant of {1e3 / rate:.3g} ms; the guard's thermal model "
                    f"needs at least {1e3 / _FASTEST:.3g} ms: check its unit"
                )
        return replace(heat, tolerance=self.tolerance, coupling=coupling)
