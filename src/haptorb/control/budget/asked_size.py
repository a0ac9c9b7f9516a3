"""The size of the wrench whose error is stated: one that the device can give everywhere in its workspace."""

from __future__ import annotations

import numpy as np

from haptorb.display.quantity_text import format_quantity
from haptorb.errors import InputError

__all__ = ["choose_size"]

_SHARE = 0.5  #: of the least peak wrench: the default size


def choose_size(device: str, asked: float | None, most: float, unit: str) -> float:
    """The size of the wrench [N or N·m] that the budget asks for; `most` can be given everywhere in every direction.

    None: half of the most, to one digit. Raises InputError for none or for more than can be given.

    >>> choose_size("omni", None, 0.136, "N")
    0.07
    """
    if asked is None:
        digit = 10.0 ** np.floor(np.log10(_SHARE * most))
        return float(f"{np.round(_SHARE * most / digit) * digit:.1g}")
    if not 0.0 < asked <= most:
        raise InputError(
            f"device '{device}' gives at most {format_quantity(most, unit)} in every direction everywhere in its "
            f"workspace; an error budget needs a wrench above 0 and up to that, got {asked:g} {unit}"
        )
    return asked
