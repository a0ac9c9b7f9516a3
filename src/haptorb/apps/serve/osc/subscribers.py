"""Who gets bundles: at which port, how often, and until when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from haptorb.apps.serve.osc.osc_inbox import Sender
from haptorb.errors import InputError

__all__ = ["LEASE", "MOST", "Subscriber", "Subscribers"]

LEASE = 10.0  #: a subscription holds for so long, and is renewed by another [s]
MOST = 16  #: subscribers


@final
@dataclass
class Subscriber:
    """A port that bundles go to, `rate` a second [Hz]; `due` on the loop's clock, `until` on the computer's [s].

    any_account  whoever has the port may read: its program has shown the token
    """

    to: Sender
    rate: float
    until: float
    any_account: bool = False
    due: float = float("-inf")
    sent: int = 0
    dropped: int = 0  #: that the system could not take: the way there is full

    def is_due(self, t: float) -> bool:
        """Whether the row of time `t` [s] goes to it: so that there are `rate` a second, at even distances."""
        if t < self.due - 1e-6:
            return False
        gap = 1.0 / self.rate
        # Not from `t`, which is later than was due: the rate would be too low. But nothing is made up for.
        self.due = (self.due if t - self.due < gap else t) + gap
        return True


@final
class Subscribers:
    """Everybody who gets bundles."""

    def __init__(self) -> None:
        self._known: dict[Sender, Subscriber] = {}

    @property
    def current(self) -> list[Subscriber]:
        """All of them, in the order in which they came."""
        return list(self._known.values())

    def add(self, to: Sender, rate: float, now: float, *, any_account: bool = False) -> Subscriber:
        """Send to `to` at `rate` [Hz], or renew that. Raises InputError if there are too many others."""
        known = self._known.get(to)
        if known is None:
            if len(self._known) >= MOST:
                raise InputError(f"at most {MOST} programs can subscribe at a time: end one of them")
            known = self._known[to] = Subscriber(to, rate, now + LEASE)
        elif known.rate != rate:
            known.rate, known.due = rate, float("-inf")
        known.until, known.any_account = now + LEASE, any_account
        return known

    def remove(self, to: Sender) -> None:
        """Send nothing more to `to`."""
        self._known.pop(to, None)

    def expire(self, now: float) -> None:
        """Forget those who did not renew."""
        for one in self.current:
            if one.until < now:
                self.remove(one.to)
