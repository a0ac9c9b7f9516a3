"""The force that a program outside the loop commands, as the loop passes it to the worlds that render it."""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Records, fields

__all__ = ["CLIENT_FORCE", "make_client_force"]

CLIENT_FORCE = fields(
    ("force", "f8", (3,)),  # as the client commanded it, stator frame [N]
    ("session", "f8"),  # number of its connection; 0: no command yet
    ("age", "f8"),  # of the command [s]
    ("lost", "f8"),  # since the connection was lost; 0: it is there [s]
    ("mapping", "f8"),  # number of its mapping into the stator's frame
)


def make_client_force() -> Records:
    """(1,) CLIENT_FORCE without a client: no force [N], session 0."""
    return np.zeros(1, dtype=CLIENT_FORCE)
