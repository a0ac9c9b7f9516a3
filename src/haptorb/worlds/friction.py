"""Dry friction with stiction: below breakaway the tool remains in place under a constant load."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import exp, sqrt, tanh

import numpy as np

from haptorb.arrays import Array, Record, Records, fields
from haptorb.compiled import kernel
from haptorb.devices.base import State
from haptorb.errors import InputError
from haptorb.worlds.base import World, parameter
from haptorb.worlds.dynamic import DynamicWorld, MemoryField

__all__ = ["Friction", "StickSlip"]


_FIELDS = (
    MemoryField("placed", "1", "1 once a position is known"),
    MemoryField("place", "m", "position of the tool in the last tick", (3,)),
    MemoryField("bristle", "m", "mean deflection of the bristles, z", (3,)),
    MemoryField("energy", "J", "energy in the bristles"),
)

#: Settings of the kernel.
_FRICTION = fields(
    ("sliding", "f8"),  # F_c [N]
    ("breakaway", "f8"),  # F_s [N]
    ("fading", "f8"),  # v_s [m/s]
    ("stiffness", "f8"),  # σ0 [N/m]
    ("damping", "f8"),  # σ1 [N·s/m]
    ("viscous", "f8"),  # σ2 [N·s/m]
    ("elastic", "f8"),  # share of the breakaway up to which bristles deform elastically only
)


@kernel
def _slip(f: Record, bent: float, level: float, forward: bool) -> float:
    """α, slipping share of a displacement: zero for elastic bristles, one at the maximum deflection.

    `bent` and `level` are σ0|z| and g(v) [N]; Dupont et al. 2002, eq. (12)."""
    if f.elastic <= 0.0:
        return 1.0  # as published in 1995
    if not forward:
        return 0.0
    start = f.elastic * level
    if bent <= start:
        return 0.0
    if bent >= level:
        return 1.0
    return float(0.5 + 0.5 * np.sin(np.pi * ((bent - start) / (level - start) - 0.5)))


@kernel
def _rub(memory: Records, friction: Records, p: Array, v: Array, wrench: Array) -> None:
    """Deform the bristles by the displacement to `p` (3,) [m], and fill `wrench` (6,) with the opposing force [N]."""
    m, f = memory[0], friction[0]
    z, place = m.bristle, m.place
    if m.placed == 0.0:
        for i in range(3):
            place[i] = p[i]
        m.placed = 1.0
    way = speed = bent = along = 0.0
    for i in range(3):
        step = p[i] - place[i]
        way += step * step
        speed += v[i] * v[i]
        along += (z[i] + step) * step
        z[i] += step
        bent += z[i] * z[i]
        place[i] = p[i]
    way, speed, bent = np.sqrt(way), np.sqrt(speed), np.sqrt(bent)
    ratio = speed / f.fading
    level = f.sliding + (f.breakaway - f.sliding) * np.exp(-ratio * ratio)
    slip = _slip(f, f.stiffness * bent, level, along >= 0.0)
    # Backward Euler of ż = v − α σ0|v|/g(v) z, over displacement instead of time: stable for steps of any length
    left = 1.0 / (1.0 + slip * f.stiffness * way / level)
    m.energy = 0.0
    for i in range(3):
        z[i] *= left
        rate = v[i] - slip * f.stiffness * speed / level * z[i]
        wrench[i] = -(f.stiffness * z[i] + f.damping * rate + f.viscous * v[i])
        wrench[3 + i] = 0.0
        m.energy += 0.5 * f.stiffness * z[i] * z[i]


@dataclass(frozen=True)
class Friction(DynamicWorld):
    """Dry friction with stiction: presliding, hysteresis and breakaway.

    The LuGre model: bristles of mean deflection z bend with the displacement and slip when they are bent too far,
    ż = v − α σ0|v|/g(v) z, F = −(σ0 z + σ1 ż + σ2 v), g(v) = F_c + (F_s − F_c) exp(−(v/v_s)²). With `elastic` zero it
    is as published (Canudas de Wit, Olsson, Åström and Lischinsky 1995, α = 1); then an oscillating load below
    breakaway creeps. Above zero, bristles only bend up to that share of g (Dupont, Hayward, Armstrong and
    Altpeter 2002), and an oscillating load stays. z follows the measured displacement and not an integrated velocity:
    sticking is a spring to a position.

    Passive if σ2 ≥ σ1 (F_s − F_c)/F_c (Barabanov and Ortega 2000); with other parameters it is declared active.

    >>> bool(Friction().passive), bool(Friction(viscous=0).passive)
    (True, False)
    """

    asks = "force"

    sliding: float = parameter(0.12, "N", 0.005, 1, "F_c: friction while sliding fast")
    breakaway: float = parameter(0.25, "N", 0.005, 1.5, "F_s: breakaway force")
    fading: float = parameter(0.03, "m/s", 0.0005, 0.5, "v_s: speed over which breakaway fades to sliding")
    stiffness: float = parameter(300.0, "N/m", 10, 1e5, "σ0: stiffness of the bristles before they slip")
    damping: float = parameter(0.3, "N·s/m", 0, 400, "σ1: damping of the bristles")
    viscous: float = parameter(0.35, "N·s/m", 0, 5, "σ2: viscous friction")
    elastic: float = parameter(
        0.8, "1", 0, 0.95, "share of the breakaway force below which nothing slips; 0: as published"
    )

    def __post_init__(self) -> None:
        World.__post_init__(self)
        if self.breakaway < self.sliding:
            raise InputError(
                f"Friction.breakaway (F_s) must not be smaller than sliding (F_c = {self.sliding:g} N); got "
                f"{self.breakaway:g} N"
            )
        least = self.damping * (self.breakaway - self.sliding) / self.sliding
        object.__setattr__(self, "passive", self.viscous >= least)

    @property
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """Last position, bristle deflection and its energy."""
        return _FIELDS

    @property
    def bound(self) -> float:
        """[N] for a hand of at most 2 m/s."""
        return self.breakaway + 2.0 * (self.damping * (1.0 + self.breakaway / self.sliding) + self.viscous)

    @cached_property
    def _facts(self) -> Records:
        """(1,) _FRICTION: constant settings."""
        made = np.zeros(1, dtype=_FRICTION)
        for name in _FRICTION.names or ():
            made[name] = getattr(self, name)
        return made

    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) force of the bristles after the displacement since the previous tick, for any `dt` [N]."""
        wrench = np.empty(6)
        _rub(memory, self._facts, np.ascontiguousarray(state.p), np.ascontiguousarray(state.v), wrench)
        return wrench


# --------------------------------------------------------------------------------------------------
# Dry friction with breakaway, without memory.


@dataclass(frozen=True)
class StickSlip(World):
    """Stribeck friction against the velocity: F = −(F_c + (F_s − F_c) e^(−(v/v_s)²)) tanh(v/v_0) v̂.

    A force that decreases with speed is what makes fingers and bows stick and slip. It always opposes the motion,
    so it is passive; it has no memory, so below v_0 it creeps instead of sticking. Source: Armstrong-Hélouvry et al.
    1994, section 2.
    """

    asks = "force"

    sliding: float = parameter(0.1, "N", 0, 0.5, "F_c: friction while sliding fast")
    breakaway: float = parameter(0.25, "N", 0, 1, "F_s: friction at the start of sliding")
    fading: float = parameter(0.03, "m/s", 0.001, 0.5, "v_s: speed over which breakaway fades to sliding")
    creep: float = parameter(0.005, "m/s", 0.001, 0.1, "v_0: speed below which the friction rounds off")

    @property
    def bound(self) -> float:
        """[N]"""
        return max(self.sliding, self.breakaway)

    def wrench(self, state: State) -> Array:
        """(6,) force against the velocity [N]."""
        x, y, z = state.v.tolist()
        v = sqrt(x * x + y * y + z * z)
        wrench = np.zeros(6)
        if v > 0.0:
            level = self.sliding + (self.breakaway - self.sliding) * exp(-((v / self.fading) ** 2))
            brake = -level * tanh(v / self.creep) / v
            wrench[0], wrench[1], wrench[2] = brake * x, brake * y, brake * z
        return wrench
