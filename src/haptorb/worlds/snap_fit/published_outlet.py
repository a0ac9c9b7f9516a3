"""The outlet of the paper, for comparison with its Fig. 8; use `Outlet` for rendering."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from haptorb.devices.state import State
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.physics.beams import Model, appendix_b, compliance
from haptorb.physics.hook import TABLE_3
from haptorb.worlds.parameter import parameter
from haptorb.worlds.world import TargetWorld

__all__ = ["PublishedOutlet"]


@dataclass(frozen=True)
class PublishedOutlet(TargetWorld):
    """Bai 2012, eqs. (14)–(18) with errata corrected: the world of Fig. 8 (socket as in Table 3).

    Pulling: F_X' = −E w μ (w_p sec ε − w_s)/(Ω₊ + μΩ₋), F_Y' and T_Z' = F_Y' (h − p_x) as in (17), (18) with the
    missing factor (E10). F_X' is printed positive, the pull of the hand; on the plug it is the opposite. The plug ends
    abruptly at p_x = h. For insertion, friction reverses and Ω₊ − μΩ₋ replaces Ω₊ + μΩ₋, as in (10).

    >>> PublishedOutlet().wrench(State.at((0.001, 0, 0), R_SR=np.eye(3), v=(1.0, 0, 0))).round(1).tolist()
    [-49.6, 0.0, 0.0, 0.0, 0.0, 0.0]
    """

    passive: ClassVar[bool] = False
    continuous: ClassVar[bool] = False

    youngs_modulus: float = parameter(113e9, "Pa", 1e9, 250e9, "E of the socket's hooks")
    friction: float = parameter(0.134, "", 0.0, 1.0, "μ between plug and hooks")
    plug_width: float = parameter(6.3e-3, "m", 1e-3, 30e-3, "w_p: width of the plug across the hooks")
    opening: float = parameter(4.8e-3, "m", 0.5e-3, 30e-3, "w_s: gap between the hooks without the plug")
    arm: float = parameter(16e-3, "m", 5e-3, 40e-3, "h: distance from the inserted plug's end to the hooks (assumed)")
    creep: float = parameter(5e-3, "m/s", 1e-4, 0.1, "speed below which friction is viscous")
    beam: Model = "paper"
    surface_height: Literal["corrected", "printed"] = "corrected"  #: H_x by (13), or 1 + δ/h₀ as printed (E9)

    _omega: tuple[float, float, float] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        TargetWorld.__post_init__(self)
        if self.surface_height not in ("corrected", "printed"):
            raise InputError(f"surface_height must be 'corrected' or 'printed'; got {self.surface_height!r}")
        if self.beam == "paper":
            bent = None if self.surface_height == "corrected" else 0.5 * (self.plug_width - self.opening)
            soft = appendix_b(TABLE_3, deflection=bent)
            plus, minus = soft.plus, soft.minus
        else:
            right = compliance(TABLE_3, TABLE_3.peak, self.beam)
            plus, minus = float(right.plus), float(right.minus)
        omega = (plus, minus, self.youngs_modulus * TABLE_3.width)
        object.__setattr__(self, "_omega", omega)

    def wrench(self, state: State) -> Array:
        """(6,) on the plug, about o' [N, N·m]."""
        x, y, _ = state.p
        R = state.R_SR
        out = np.zeros(6)
        c = self.arm - x  # h − x₀ − x
        if c <= 0.0 or R[0, 0] < 0.5:
            return out
        tan = -R[1, 0] / R[0, 0]  # ε_z counts clockwise about Z'
        sec = math.sqrt(1.0 + tan * tan)
        slide = state.v[0] / math.sqrt(state.v[0] ** 2 + self.creep**2)
        plus, minus, stiff = self._omega
        stiffness = stiff / (plus + self.friction * slide * minus)
        half = 0.5 * self.plug_width * sec
        f_1 = stiffness * max(half + c * tan - 0.5 * self.opening - y, 0.0)  # (15), (16)
        f_2 = stiffness * max(half - c * tan - 0.5 * self.opening + y, 0.0)
        out[0] = -self.friction * slide * (f_1 + f_2)  # (17), on the plug
        out[1] = f_1 - f_2
        out[5] = out[1] * c  # (18) with (17)'s factor (E10)
        return out
