"""One connection of a client: its number, its name, how it sees the device, and how often it asks."""

from __future__ import annotations

from time import monotonic
from typing import final

from haptorb.apps.serve.haply.space import Space

__all__ = ["Session"]

_NAME = 60  #: of a client's profile [characters]
_SMOOTH = 0.5  #: weight of the newest rate
_TURNED = 0.087  #: change of a unit force that is no small turn: 5°


@final
class Session:
    """The client `number` at the address `peer`, seeing the device as `space` says.

    unreadable  how many of its messages were unreadable; one without text is readable
    refused     whether it was informed that another client holds the device, since it could last command
    """

    def __init__(self, number: int, peer: str, space: Space) -> None:
        self.number, self.peer, self.space = number, peer, space
        self.mapping = 0  #: number of its mapping: with another one the same command points elsewhere
        self._axes = _force_axes(space)
        self.name = ""
        self.messages = self.unreadable = 0
        self.rate = 0.0  #: messages per second
        self.refused = False
        self._since, self._counted = monotonic(), 0

    def change_space(self, space: Space) -> None:
        """See the device as `space` says from now on: where its force points is not what it was."""
        if space != self.space:
            self.space, self._axes = space, _force_axes(space)
            self.mapping += 1  # safety: mapping-counts

    def move_space(self, space: Space) -> None:
        """As `change_space`, for what a client moves while it commands: small turns, one after the other, stay the same
        mapping, because its force turns no faster than the guard permits."""
        self.space = space
        axes = _force_axes(space)
        if max(abs(a - b) for a, b in zip(axes, self._axes, strict=True)) > _TURNED:
            self._axes = axes
            self.mapping += 1

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


def _force_axes(space: Space) -> tuple[float, ...]:
    """Whither unit forces along the client's axes point in the stator's frame, nine numbers."""
    return tuple(part for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1)) for part in space.stator_force(axis))
