"""Buildability checks of a device: each condition with its value, limit and margin."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from haptorb.display import format_quantity
from haptorb.errors import DeviceError
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.wire import WireLayers, wind

__all__ = [
    "CERTAIN", "BuildCheck", "BuildError", "check_wire", "compare_fill", "format_bound", "refuse_unbuildable",
]  # fmt: skip

CERTAIN = 2.0  #: standard uncertainties within which two statements agree


def format_bound(value: float, unit: str) -> str:
    """Format `value`: angles in degrees, shares in per cent.

    >>> format_bound(0.0198, "m"), format_bound(np.pi / 6, "rad"), format_bound(0.0357, "1")
    ('19.8 mm', '30°', '3.57 %')
    """
    if value == 0.0:
        return "0"
    if unit == "rad":
        return f"{np.degrees(value):.3g}°"
    return f"{100 * value:.3g} %" if unit == "1" else format_quantity(value, unit, 4)


@dataclass(frozen=True)
class BuildCheck:
    """One condition: `value` must be at most (or at least) `limit`, both in `unit`."""

    condition: str  #: the condition, in a few words; the same for all identical parts
    name: str  #: the part, and its compared quantity
    value: float
    limit: float
    unit: str
    remedy: str  #: what to change if it does not hold
    at_least: bool = False
    note: str = ""  #: components of the value

    @property
    def margin(self) -> float:
        """Margin of the value to the limit; negative: the condition does not hold."""
        return self.value - self.limit if self.at_least else self.limit - self.value

    @property
    def holds(self) -> bool:
        """Whether the value is within the limit; sizes computed from each other may differ in the last digits."""
        return bool(self.margin >= -1e-9 * max(abs(self.value), abs(self.limit)))

    @property
    def miss(self) -> float:
        """Relative violation of the limit, below 1; 0 if the check holds."""
        short = max(-self.margin, 0.0)
        return 0.0 if self.holds else short / (short + (abs(self.limit) or 1.0))

    def explain(self) -> str:
        """The sentence for a device in which it does not hold."""
        value, limit = (format_bound(one, self.unit) for one in (self.value, self.limit))
        note = f" ({self.note})" if self.note else ""
        bound = f"at least {limit} is needed" if self.at_least else f"at most {limit} is possible"
        return f"cannot be built ({self.condition}): {self.name}: {value}{note}, but {bound}; {self.remedy}"


class BuildError(DeviceError):
    """A device that cannot be built; `failures` are the checks that do not hold."""

    def __init__(self, name: str, messages: Sequence[str], failures: Sequence[BuildCheck]) -> None:
        lines = "\n".join(f"device '{name}': {line}" for line in messages)
        text = f"{lines}\ncorrect the file, or study it as it is"
        super().__init__(f"{text}: override=True", command=f"{text}: `haptorb inspect DEVICE --override`")
        self.failures = tuple(failures)
        self._name, self._messages = name, tuple(messages)

    def __reduce__(self) -> tuple[type[BuildError], tuple[object, ...]]:
        return BuildError, (self._name, self._messages, self.failures)

    def rename(self, name: str) -> BuildError:
        """The same of the device, or file, called `name`."""
        return BuildError(name, self._messages, self.failures)


def refuse_unbuildable(name: str, checks: Iterable[BuildCheck], findings: Iterable[str] = ()) -> None:
    """Reject device `name` if a check fails, or if there are `findings` (sentences).

    Raises BuildError, whose message tells how to study the device all the same.
    """
    failures = [check for check in checks if not check.holds]
    messages = [*findings, *(check.explain() for check in failures)]
    if messages:
        raise BuildError(name, messages, failures)


def check_wire(
    name: str, coil: Coil, copper: float, overall: float, origin: str = ""
) -> tuple[BuildCheck, WireLayers | None]:
    """Whether the turns of `coil` fit in layers in its section, of a wire `copper` [m] thick, `overall` [m] with its
    enamel; and its layers. `origin`: where the wire comes from, if the file does not state it."""
    section = coil.outer_radius - coil.inner_radius
    layers = wind(coil.turns, coil.inner_radius, coil.length, overall)
    wire = f"{copper * 1e3:.3g} mm, {overall * 1e3:.3g} mm over the enamel{origin}"
    if layers is None:
        check = BuildCheck(
            "wire that fits between the flanges", name, overall, coil.length, "m",
            "increase the winding's length, or reduce the wire", note=wire,
        )  # fmt: skip
        return check, None
    check = BuildCheck(
        "wire that fits in layers in its section", f"{name}, depth of its wire", layers.depth, section, "m",
        "increase the winding's outer radius or length, or reduce the turns or the wire",
        note=f"{coil.turns:g} turns of {wire}: {layers.layers} layers of {layers.per_layer}",
    )  # fmt: skip
    return check, layers


def compare_fill(name: str, made: float, stated: float, spread: float) -> BuildCheck:
    """Whether the resistance that a winding's `fill` makes agrees with the stated one [Ω]; `spread`: its relative
    standard uncertainty."""
    return BuildCheck(
        "wire with the stated resistance", f"{name}, relative difference of the two", abs(made / stated - 1),
        CERTAIN * spread, "1", "correct coils.resistance or windings.fill, or increase uncertainty.resistance",
        note=f"windings.fill makes {made:.3g} Ω instead of {stated:.3g} Ω",
    )  # fmt: skip
