"""The list of quantities by name, and how a module adds its own to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from haptorb.design.candidate import DesignCandidate
from haptorb.design.quantity import DesignQuantity, Sense
from haptorb.errors import InputError

__all__ = ["Compute", "describe", "option"]

Compute = Callable[[DesignCandidate], float]


def describe(name: str, unit: str, sense: Sense, text: str, by_kind: Mapping[str, Compute]) -> DesignQuantity:
    """A quantity that each kind of device computes in its own way; InputError for a device of another kind."""
    kinds = tuple(by_kind)

    def compute(candidate: DesignCandidate) -> float:
        kind = candidate.device.kind
        if kind.name not in by_kind:
            raise InputError(
                f"quantity '{name}' is computed for devices of kind {' and '.join(kinds)}; "
                f"'{candidate.base.name}' is a {kind.title}"
            )
        return float(by_kind[kind.name](candidate))

    return DesignQuantity(name, unit, sense, text, kinds, compute)


def option(candidate: DesignCandidate, name: str, default: float) -> float:
    """The number `name` of the design file's table [evaluation]; InputError for what is no positive number."""
    value = candidate.options.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
        raise InputError(f"evaluation.{name} must be a positive number in SI units; got {value!r}")
    return float(value)
