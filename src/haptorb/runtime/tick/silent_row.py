"""The row of a tick in which the device did not answer: nothing was measured, and nothing is asked."""

from __future__ import annotations

import numpy as np

from haptorb.control.protection.protection import Protection
from haptorb.numerics.arrays import Array
from haptorb.runtime.row import RowLayout

__all__ = ["fill_silent_row"]


def fill_silent_row(row: Array, layout: RowLayout, protection: Protection, coil_state: float, now: float) -> None:
    """Fill `row` (width,), at `now` [s] on the loop's clock, with what is known all the same, each number in the unit
    of its field; NaN elsewhere."""
    row[:] = np.nan
    row[layout["t"]] = now
    row[layout["guard"]] = protection.guard_state
    row[layout["trip"]] = protection.reason
    row[layout["coil_state"]] = coil_state
    row[layout["gain"]] = row[layout["valid"]] = row[layout["wanted"]] = 0.0
