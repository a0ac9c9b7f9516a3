"""Reproducible noise, equal on every machine for a seed: xoshiro256++ (Blackman and Vigna 2019), in compiled code."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Array
from haptorb.compiled import kernel
from haptorb.errors import InputError

__all__ = ["Noise", "fill_normal", "seed_noise"]


Noise: TypeAlias = NDArray[np.uint64]


_TO_MIDDLE = 0x3FF0000000000000 - 0x3FE6A09E667F3BCD  #: in bits, from 1/√2 to 1: rounds to the nearest power of two
_LN2 = math.log(2.0)
_U17, _U19, _U23, _U41, _U45, _U11 = (np.uint64(n) for n in (17, 19, 23, 41, 45, 11))


def seed_noise(seed: int) -> Noise:
    """(4,) state of a generator for `seed`, any integer from 0.

    Raises InputError for an invalid seed.

    >>> bool((seed_noise(1) == seed_noise(1)).all() and (seed_noise(1) != seed_noise(2)).any())
    True
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed must be an integer, 0 or more; got {seed!r}")
    state: Noise = np.random.SeedSequence(int(seed)).generate_state(4, np.uint64).astype(np.uint64)
    return state


@kernel
def _uniform(s: Noise) -> float:
    """Uniform number in (0, 1]: 53 bits, never zero, so that its logarithm exists."""
    mixed = s[0] + s[3]
    mixed = ((mixed << _U23) | (mixed >> _U41)) + s[0]
    shift = s[1] << _U17
    s[2] ^= s[0]
    s[3] ^= s[1]
    s[1] ^= s[2]
    s[0] ^= s[3]
    s[2] ^= shift
    s[3] = (s[3] << _U45) | (s[3] >> _U19)
    return (np.float64(mixed >> _U11) + 1.0) * (1.0 / 9007199254740992.0)


@kernel
def _fill_uniform(s: Noise, first: Array, second: Array) -> None:
    """Fill both arrays alternately with uniform numbers in (0, 1]."""
    for i in range(first.shape[0]):
        first[i] = _uniform(s)
        second[i] = _uniform(s)


@kernel
def _radii(u: Array) -> None:
    """u (n,) becomes √(−2 ln u): ln m for the mantissa m from 1/√2 to √2 as 2 artanh((m − 1)/(m + 1)), by its series.

    Plain arithmetic is vectorised by the compiler, the library's logarithm is not; likewise below.
    """
    bits = u.view(np.int64)
    for i in range(u.shape[0]):
        exponent = np.float64(np.int32((bits[i] + _TO_MIDDLE) >> 52) - 1023)
        bits[i] = bits[i] - (np.int64(np.int32((bits[i] + _TO_MIDDLE) >> 52) - 1023) << 52)  # mantissa only
        f = (u[i] - 1.0) / (u[i] + 1.0)
        g = f * f  # at most 0.0295
        series = 1.0 / 19.0 + g * (1.0 / 21.0)
        series = 1.0 / 17.0 + g * series
        series = 1.0 / 15.0 + g * series
        series = 1.0 / 13.0 + g * series
        series = 1.0 / 11.0 + g * series
        series = 1.0 / 9.0 + g * series
        series = 1.0 / 7.0 + g * series
        series = 1.0 / 5.0 + g * series
        series = 1.0 / 3.0 + g * series
        u[i] = math.sqrt(max(-2.0 * (exponent * _LN2 + 2.0 * f * (1.0 + g * series)), 0.0))


@kernel
def _fill_cos_sin(turns: Array, radius: Array, across: Array) -> None:
    """radius (n,) becomes radius · cos, across (n,) radius · sin of 2π `turns` (n,), from 0 to 1: Taylor over ±45°."""
    for i in range(turns.shape[0]):
        quarter = np.rint(4.0 * turns[i])
        r = (4.0 * turns[i] - quarter) * (0.5 * math.pi)
        g = r * r  # at most 0.617
        s = -1.0 / 1307674368000.0 + g * (1.0 / 355687428096000.0)
        s = 1.0 / 6227020800.0 + g * s
        s = -1.0 / 39916800.0 + g * s
        s = 1.0 / 362880.0 + g * s
        s = -1.0 / 5040.0 + g * s
        s = 1.0 / 120.0 + g * s
        s = -1.0 / 6.0 + g * s
        s = r * (1.0 + g * s)
        c = -1.0 / 87178291200.0 + g * (1.0 / 20922789888000.0)
        c = 1.0 / 479001600.0 + g * c
        c = -1.0 / 3628800.0 + g * c
        c = 1.0 / 40320.0 + g * c
        c = -1.0 / 720.0 + g * c
        c = 1.0 / 24.0 + g * c
        c = 1.0 + g * (-0.5 + g * c)
        # after so many quarter turns (cos, sin) is (c, s), (−s, c), (−c, −s), (s, −c) and (c, s) again
        odd = quarter == 1.0 or quarter == 3.0
        x = s if odd else c
        y = c if odd else s
        size = radius[i]
        radius[i] = -size * x if quarter == 1.0 or quarter == 2.0 else size * x
        across[i] = -size * y if quarter == 2.0 or quarter == 3.0 else size * y


@kernel
def fill_normal(s: Noise, out: Array) -> None:
    """Fill out (n,) with independent standard normals (Box and Muller 1958), advancing `s` (4,)."""
    pairs = (out.shape[0] + 1) // 2
    radius, turns, across = np.empty(pairs), np.empty(pairs), np.empty(pairs)
    _fill_uniform(s, radius, turns)
    _radii(radius)
    _fill_cos_sin(turns, radius, across)
    for i in range(out.shape[0] // 2):
        out[2 * i] = radius[i]
        out[2 * i + 1] = across[i]
    if out.shape[0] % 2:
        out[out.shape[0] - 1] = radius[pairs - 1]
