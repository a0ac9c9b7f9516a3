"""The readings of a real device, live, with its coils off."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from time import monotonic, sleep
from typing import Any

import numpy as np

from haptorb.control.protection.trip import CoilState
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.driver import Driver
from haptorb.sensing.sample import Sample

__all__ = ["line", "monitor", "numbers", "state_words"]

_STATES = {
    CoilState.OFF: "off",
    CoilState.ON: "on",
    CoilState.UNKNOWN: "COIL STATE UNKNOWN: switch the supply off",
}

_TURNS = 24  #: readings at most for all field sensors; three axes in two blocks need six of them, with luck


def monitor(
    driver: Driver,
    rate: float = 10.0,
    duration: float = float("inf"),
    clock: Callable[[], float] = monotonic,
    wait: Callable[[float], None] = sleep,
) -> Iterator[Sample]:
    """Samples of `driver` (not open yet) at `rate` [Hz] for `duration` [s]; nothing is ever switched on.

    A driver that reads its field sensors in turns is read as often as they need; each sample has the last of every one.
    """
    if not 0.0 < rate <= 200.0:
        raise InputError(f"rate must be above 0 and at most 200 Hz; got {rate} Hz")
    with driver:
        start = clock()
        count = 0
        while clock() - start < duration:
            yield _read_whole(driver, clock() - start)
            count += 1
            wait(max(0.0, start + count / rate - clock()))


def _read_whole(driver: Driver, now: float) -> Sample:
    sample = driver.read(now)
    field = sample.field.copy()
    for _ in range(_TURNS):
        if np.isfinite(field).all():
            break
        part = driver.read(now).field
        field = np.where(np.isfinite(part), part, field)
    return replace(sample, field=field)


def state_words(state: CoilState) -> str:
    """Whether current can flow, for people.

    >>> state_words(CoilState.OFF), state_words(CoilState.UNKNOWN)
    ('off', 'COIL STATE UNKNOWN: switch the supply off')
    """
    return _STATES[state]


def numbers(sample: Sample, state: CoilState = CoilState.OFF) -> dict[str, Any]:
    """The same as plain JSON types; what a sensor did not tell is null."""

    def to_json(values: Array) -> list[Any]:
        return [float(one) if np.isfinite(one) else None for one in values]

    return {
        "t_s": sample.t, "currents_a": to_json(sample.currents),
        "temperatures_degc": to_json(sample.temperatures - 273.15),
        "field_t": [to_json(one) for one in sample.field], "coil_state": state.name.lower(),
    }  # fmt: skip


def line(sample: Sample, state: CoilState = CoilState.OFF) -> str:
    """One line for people: time, currents, temperatures, and the field's size at every sensor; and the coils' `state`,
    if they are not off.

    >>> from haptorb.runtime.drivers.electronics import invalid_pose
    >>> line(Sample(1.5, np.array([1.0, -2, 0]), np.full(3, 300.0), np.eye(3) * 1e-3, invalid_pose(0.0)))
    '   1.50 s   +1.000  -2.000  +0.000 A    26.9  26.9  26.9 °C   1.00 1.00 1.00 mT'
    """
    currents = "  ".join(f"{one:+.3f}" for one in sample.currents)
    heat = "  ".join(f"{one - 273.15:.1f}" for one in sample.temperatures)
    field = " ".join(f"{one * 1e3:.2f}" for one in np.linalg.norm(sample.field, axis=1))
    text = f"{sample.t:7.2f} s   {currents} A    {heat} °C   {field} mT"
    return text if state is CoilState.OFF else f"{text}   coils: {state_words(state)}"
