"""Noise that is the same on every machine for a seed: xoshiro256++ (Blackman and Vigna 2019), inside compiled code."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from haptorb.errors import InputError
from haptorb.physics.arrays import Array
from haptorb.physics.compiled import kernel

__all__ = ["Noise", "fill_normal", "seeded", "stepped"]

Noise: TypeAlias = NDArray[np.uint64]

_U17, _U19, _U23, _U41, _U45, _U11 = (np.uint64(n) for n in (17, 19, 23, 41, 45, 11))


def seeded(seed: int) -> Noise:
    """(4,) a generator's state for `seed`, any integer from 0 on.

    Raises InputError for what is none.

    >>> bool((seeded(1) == seeded(1)).all() and (seeded(1) != seeded(2)).any())
    True
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed must be an integer from 0 on; got {seed!r}")
    state: Noise = np.random.SeedSequence(int(seed)).generate_state(4, np.uint64).astype(np.uint64)
    return state


@kernel
def _uniform(s: Noise) -> float:
    """A number in (0, 1]: 53 bits, never zero, so that its logarithm exists."""
    mixed = s[0] + s[3]
    mixed = ((mixed << _U23) | (mixed >> _U41)) + s[0]
    kept = s[1] << _U17
    s[2] ^= s[0]
    s[3] ^= s[1]
    s[1] ^= s[2]
    s[0] ^= s[3]
    s[2] ^= kept
    s[3] = (s[3] << _U45) | (s[3] >> _U19)
    return (np.float64(mixed >> _U11) + 1.0) * (1.0 / 9007199254740992.0)


@kernel
def fill_normal(s: Noise, out: Array) -> None:
    """Fill out (n,) with independent standard normals (Box and Muller 1958), advancing `s` (4,)."""
    for i in range(0, out.shape[0], 2):
        radius = np.sqrt(-2.0 * np.log(_uniform(s)))
        angle = 2.0 * np.pi * _uniform(s)
        out[i] = radius * np.cos(angle)
        if i + 1 < out.shape[0]:
            out[i + 1] = radius * np.sin(angle)


@kernel
def stepped(value: float, step: float) -> float:
    """`value` as a converter with quantum `step` tells it; step 0: an ideal one."""
    return np.rint(value / step) * step if step > 0.0 else value
