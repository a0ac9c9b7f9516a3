"""What a server needs, found and opened before the servo starts: its ports above all."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Any

__all__ = ["ServerPreparation"]


@dataclass
class ServerPreparation:
    """spec         the settings of the server's process, plain JSON types
    descriptors  open sockets that it inherits, in order; closed here once it has them
    address      where programs find it, for people
    remarks      what a person must know beside: a token, say
    """

    spec: dict[str, Any]
    address: str
    descriptors: list[int] = field(default_factory=list)
    remarks: tuple[str, ...] = ()

    def close(self) -> None:
        """The server's process has its sockets, or they are closed. May be called twice."""
        while self.descriptors:
            os.close(self.descriptors.pop())
