"""How steep a world is: how its wrench changes with place and with velocity, by differences all over a workspace.

A spring that pulls back counts as positive stiffness: it is what sampling and delay can make oscillate. Negative
stiffness pushes away, as from the top of a dome; that a hand can slip off there is what such a world is for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from haptorb.numerics.arrays import Array

__all__ = ["Field", "Steepest", "Steepness", "steepest"]

#: (3,) force at a place (3,), with a velocity (3,), at a time [s]
Field = Callable[[Array, Array, float], Array]

_STEP = 2e-5  #: of the differences [m]
_SPEED = 0.05  #: of the differences by velocity [m/s]
_JUMP = 0.6  #: share of a change that is left over a quarter of the step: below for slopes, above for jumps
_WAYS = 150  #: on so many ways jumps are sought
_NOTHING = 1e-3  #: a smaller jump is nothing to be felt [N]


@dataclass(frozen=True)
class Steepness:
    """At one place, along one direction: stiffness and damping as the hand meets them.

    A complex stiffness is an eigenvalue of a force field that is no gradient: it also turns what it pushes.
    """

    stiffness: complex  #: [N/m]
    damping: float  #: [N·s/m]
    place: tuple[float, float, float]  #: [m]


@dataclass(frozen=True)
class Steepest:
    """What is steepest anywhere.

    candidates   where the loop may be nearest to its limits: the strongest springs, dampers and pushing dampers
    away         the greatest stiffness that pushes away [N/m]
    jump         the greatest jump of the force [N]: there no gradient exists
    """

    candidates: tuple[Steepness, ...]
    away: float
    jump: float

    @property
    def stiffness(self) -> float:
        """The greatest that pulls back [N/m]."""
        return max((one.stiffness.real for one in self.candidates), default=0.0) + 0.0

    @property
    def damping(self) -> float:
        """The greatest magnitude of the world's own damping [N·s/m]."""
        return max((abs(one.damping) for one in self.candidates), default=0.0)


def steepest(
    field: Field, places: Array, inside: Callable[[Array], bool] = lambda p: True, *, seed: int = 0, keep: int = 12
) -> Steepest:
    """Look at `places` (n, 3) [m], climb from the steepest as far as `inside`, and keep the `keep` most critical.

    Where `field` jumps the change is no slope; jumps are measured, also between the places, and left out.
    """
    rng = np.random.default_rng(seed)
    times = rng.uniform(0.0, 10.0, len(places))
    found: list[Steepness] = []
    away, jump = 0.0, _greatest_jump(field, places, times, inside)

    def look(p: Array, t: float, moving: bool) -> float:
        """The steepness at `p`; its strongest spring [N/m]."""
        nonlocal away, jump
        G, leap = _position_gradient(field, p, t)
        jump = max(jump, leap)
        at = (float(p[0]), float(p[1]), float(p[2]))
        pull, u = np.linalg.eigh(-0.5 * (G + G.T))
        away = max(away, -float(pull[0]))
        for D in _velocity_gradient(field, p, t) if moving else (np.zeros((3, 3)),):
            for j in range(3):
                found.append(Steepness(float(pull[j]), float(u[:, j] @ D @ u[:, j]), at))
        for gamma in np.linalg.eigvals(-G):
            if abs(gamma.imag) > 1e-6 * abs(gamma) and gamma.imag > 0:
                found.append(Steepness(complex(gamma), 0.0, at))
        return float(np.abs(pull).max())

    sizes = [look(p, t, True) for p, t in zip(places, times, strict=True)]
    scale = float(np.abs(places).max())
    for n in np.argsort(sizes)[::-1][:6]:
        p, best, reach, t = places[n].copy(), sizes[n], 0.05 * scale, float(times[n])
        while reach > _STEP:
            tried = [q for q in p + 0.5 * reach * rng.normal(size=(8, 3)) if inside(q)]
            grown = [look(q, t, False) for q in tried]
            m = int(np.argmax(grown)) if grown else -1
            if grown and grown[m] > best:
                p, best = tried[m], grown[m]
            else:
                reach *= 0.5
        look(p, t, True)
    return Steepest(_select_critical(found, keep), away, jump)


def _select_critical(found: list[Steepness], keep: int) -> tuple[Steepness, ...]:
    """The strongest springs, the strongest dampers and the strongest pushing dampers, each only once."""
    by: tuple[Callable[[Steepness], float], ...] = (
        lambda one: one.stiffness.real,
        lambda one: abs(one.stiffness) if one.stiffness.imag else 0.0,
        lambda one: one.damping,
        lambda one: -one.damping,
    )
    chosen: dict[Steepness, None] = {}
    for key in by:
        for one in sorted(found, key=key, reverse=True)[: keep // len(by)]:
            if key(one) > 1e-9:
                chosen[one] = None
    return tuple(chosen)


def _position_gradient(field: Field, p: Array, t: float) -> tuple[Array, float]:
    """(3, 3) ∂F/∂p [N/m], columns that jump left out, and the greatest jump [N]."""
    G, jump, still = np.zeros((3, 3)), 0.0, np.zeros(3)
    for j in range(3):
        step = np.zeros(3)
        step[j] = _STEP
        wide = field(p + step, still, t) - field(p - step, still, t)
        near = field(p + step / 4, still, t) - field(p - step / 4, still, t)
        whole, part = float(np.linalg.norm(wide)), float(np.linalg.norm(near))
        if whole > _NOTHING and (part > _JUMP * whole or part == 0.0):  # else the force follows the step
            beside = 1.25 * step if part == 0.0 else step
            leap = _find_jump(field, p - beside, p + beside, t)
            if leap > _NOTHING:
                jump = max(jump, leap)
                continue
        G[:, j] = near / (_STEP / 2)
    return G, jump


def _greatest_jump(field: Field, places: Array, times: Array, inside: Callable[[Array], bool]) -> float:
    """The greatest jump [N] on straight ways from each place to the next: the steepest piece, halved until it shows."""
    still, jump = np.zeros(3), 0.0
    ways = []
    for a, b, t in list(zip(places, np.roll(places, 1, axis=0), times, strict=True))[:_WAYS]:
        forces = np.array([field(a + s * (b - a), still, t) for s in np.linspace(0, 1, 33)])
        change = np.linalg.norm(np.diff(forces, axis=0), axis=1)
        n = int(change.argmax())
        ways.append((float(change[n]), a + n / 32 * (b - a), a + (n + 1) / 32 * (b - a), t))
    for change, low, high, t in sorted(ways, key=lambda way: -way[0])[:40]:
        if change <= max(jump, _NOTHING):
            break
        if inside(low) and inside(high):
            jump = max(jump, _find_jump(field, low, high, t))
    return jump


def _find_jump(field: Field, low: Array, high: Array, t: float) -> float:
    """The jump [N] somewhere between two places: the half that changes more is halved until a slope would be gone."""
    still = np.zeros(3)
    while np.linalg.norm(high - low) > 1e-9:
        middle = 0.5 * (low + high)
        f = field(middle, still, t)
        first = np.linalg.norm(f - field(low, still, t)) > np.linalg.norm(field(high, still, t) - f)
        low, high = (low, middle) if first else (middle, high)
    leap = float(np.linalg.norm(field(high, still, t) - field(low, still, t)))
    return leap if leap > _NOTHING else 0.0


def _velocity_gradient(field: Field, p: Array, t: float) -> tuple[Array, Array]:
    """(3, 3) −∂F/∂v [N·s/m], symmetric: the one that brakes most and the one that pushes most, of standing still and of
    moving either way along each axis."""
    found = []
    for at in (np.zeros(3), *(_SPEED * np.eye(3)), *(-_SPEED * np.eye(3))):
        D = np.zeros((3, 3))
        for j in range(3):
            step = np.zeros(3)
            step[j] = 1e-4
            D[:, j] = -(field(p, at + step, t) - field(p, at - step, t)) / 2e-4
        found.append(0.5 * (D + D.T))
    spread = [np.linalg.eigvalsh(D) for D in found]
    most = max(range(len(found)), key=lambda n: float(spread[n][-1]))
    least = min(range(len(found)), key=lambda n: float(spread[n][0]))
    return found[most], found[least]
