"""One line of the table of benchmarks: what was measured, against whom, and against which limit."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["Metric"]


@dataclass(frozen=True)
class Metric:
    """A measured figure.

    benchmark   which one it belongs to
    what        the quantity, in words
    value       ours, in `unit`; None where it could not be measured, and then `note` says why
    unit        such as "µs" or "1/s"
    peer        the peer that did the same in the same run; empty for none
    peer_value  theirs, in `unit`
    limit       what the project promises, in `unit`; None without a promise
    at_least    the limit is a least, not a most
    note        what must be known to read the figure
    """

    benchmark: str
    what: str
    value: float | None
    unit: str
    peer: str = ""
    peer_value: float | None = None
    limit: float | None = None
    at_least: bool = False
    note: str = ""

    @property
    def ratio(self) -> float | None:
        """How many times better we are: their time over ours, or our rate over theirs; below 1 we are worse.

        >>> Metric("allocation", "one", 2.0, "µs", "DAQP", 9.0).ratio
        4.5
        """
        if self.peer_value is None or not self.value:
            return None
        return self.value / self.peer_value if self.at_least else self.peer_value / self.value

    @property
    def kept(self) -> bool | None:
        """Whether the limit is kept; None without a limit or without a figure.

        >>> Metric("tick", "ticks on time", 0.9995, "1", limit=0.999, at_least=True).kept
        True
        """
        if self.limit is None or self.value is None:
            return None
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {**asdict(self), "ratio": self.ratio, "kept": self.kept}

    @classmethod
    def read(cls, numbers: dict[str, Any]) -> Metric:
        """A row from what `numbers` gave."""
        return cls(**{key: value for key, value in numbers.items() if key not in ("ratio", "kept")})
