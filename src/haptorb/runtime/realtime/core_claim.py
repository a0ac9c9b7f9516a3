"""One core for one servo: a process that takes a core announces it to all others on the computer, for as long as it
runs."""

from __future__ import annotations

import socket
from collections.abc import Iterable

__all__ = ["claim"]

_held: list[socket.socket] = []  # until the process ends


def claim(cores: Iterable[int]) -> int:
    """The first of `cores` that no other servo holds, from here on this process's; −1 if there is none.

    The mark is a name in the kernel's abstract namespace: no file, and gone with the process however it ends.
    """
    for core in cores:
        mark = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            mark.bind(f"\0haptorb-servo-core-{core}")
        except OSError:
            mark.close()
            continue
        _held.append(mark)
        return core
    return -1
