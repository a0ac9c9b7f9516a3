"""One connection of a client: its number, its name, how it sees the device, and how often it asks."""

from __future__ import annotations

from time import monotonic
from typing import final

from haptorb.apps.serve.haply.space import Space

__all__ = ["Session"]

_NAME = 60  #: of a client's profile [characters]
_SMOOTH = 0.5  #: weight of the newest rate


@final
class Session:
    """The client `number` at the address `peer`, seeing the device as `space` says.

    unreadable  how many of its messages were unreadable; one without text is readable
    refused     whether it was informed that another client holds the device, since it could last command
    """

    def __init__(self, number: int, peer: str, space: Space) -> None:
        self.number, self.peer, self.space = number, peer, space
        self.name = ""
        self.messages = self.unreadable = 0
        self.rate = 0.0  #: messages per second
        self.refused = False
        self._since, self._counted = monotonic(), 0

    def rename(self, name: object) -> None:
        """Its profile's name, cut to what a list of clients can show."""
        if isinstance(name, str):
            self.name = "".join(letter for letter in name if letter.isprintable())[:_NAME]

    def measure(self) -> float:
        """The rate of its messages [1/s], smoothed over the last looks."""
        now = monotonic()
        passed = now - self._since
        if passed > 0.0:
            newest = (self.messages - self._counted) / passed
            self.rate += (newest - self.rate) * (_SMOOTH if self.rate else 1.0)
            self._since, self._counted = now, self.messages
        return self.rate
