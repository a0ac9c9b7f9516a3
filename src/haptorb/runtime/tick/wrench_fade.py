"""From the wrench of one version of a world to that of the next without a step."""

from __future__ import annotations

from typing import final

from haptorb.numerics.arrays import Array
from haptorb.sensing.controller_model import FADE

__all__ = ["WrenchFade"]


@final
class WrenchFade:
    """Mixes the wrench of before a change into the rendered one, less and less, for `FADE`.

    active  whether it has anything to mix in
    """

    def __init__(self) -> None:
        self.active = False
        self._before: Array | None = None  # (6,) [N, N·m]
        self._start: float | None = None  # of the first tick after the change [s]

    def begin(self, wrench: Array) -> None:
        """Go over from `wrench` (6,) [N, N·m], from the next tick on."""
        self._before, self._start, self.active = wrench.copy(), None, True

    def end(self) -> None:
        """Mix nothing in any more."""
        self._before, self.active = None, False

    def mix(self, rendered: Array, now: float) -> None:
        """Into the wrench `rendered` (6,) [N, N·m] of the tick at `now` [s]."""
        assert self._before is not None
        if self._start is None:
            self._start = now
        share = (now - self._start) / FADE
        if share >= 1.0:
            self.end()
            return
        rendered += (1.0 - share) * (self._before - rendered)
