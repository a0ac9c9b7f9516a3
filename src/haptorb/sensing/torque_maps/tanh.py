"""tanh of many numbers at once: the library's own does one after the other, and takes longer than the network's sums.

tanh x = 1 − 2/(e²ˣ + 1), with e²ˣ = 2ᵏ eʳ, k an integer and |r| ≤ ½ ln 2, and a polynomial for eʳ. Good to a few
10⁻¹⁶ of one; not relative to small values, which a sum over nodes does not ask for. The simulation's noise has series
of its own (`simulation.noise`): of logarithm, sine and cosine, so that there is nothing to share.
"""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["squash"]

_LAST = 20.0  #: beyond, tanh is one to all digits
_LOG2E, _LN2 = float(np.log2(np.e)), float(np.log(2.0))


@kernel
def squash(values: Array) -> None:
    """Replace every number of `values` (n,) by its tanh; not a number stays so."""
    powers = np.empty(values.shape[0], np.int64)
    for i in range(values.shape[0]):
        double = 2.0 * _LOG2E * min(max(values[i], -_LAST), _LAST)
        whole = np.rint(double)
        powers[i] = (np.int64(np.int32(whole)) + 1023) << 52  # the bits of 2ᵏ
        r = _LN2 * (double - whole)
        # Taylor to r¹³: the next term is below 10⁻¹⁷
        p = 1.0 / 479001600.0 + r * (1.0 / 6227020800.0)
        p = 1.0 / 39916800.0 + r * p
        p = 1.0 / 3628800.0 + r * p
        p = 1.0 / 362880.0 + r * p
        p = 1.0 / 40320.0 + r * p
        p = 1.0 / 5040.0 + r * p
        p = 1.0 / 720.0 + r * p
        p = 1.0 / 120.0 + r * p
        p = 1.0 / 24.0 + r * p
        p = 1.0 / 6.0 + r * p
        p = 0.5 + r * p
        p = 1.0 + r * p
        values[i] = 1.0 + r * p
    scale = powers.view(np.float64)
    for i in range(values.shape[0]):
        values[i] = 1.0 - 2.0 / (values[i] * scale[i] + 1.0)
