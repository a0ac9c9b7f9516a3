"""Bars for what takes longer than a moment: a motor's pair tables, or a step in which a person does something."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from haptorb.devices.base import Device
from haptorb.terminal import make_progress

__all__ = ["build_tables", "time_bar"]

_WIDTH = 40  #: of a bar, in characters
_DRAWN = 0.5  #: between two updates of a bar, by the reported time [s]


def build_tables(device: Device) -> None:
    """Build the tables of `device` if it has any, with a bar on standard error while the exact model is asked.

    Nothing is drawn where the tables come from the cache, or where standard error is not a terminal.
    """
    if device.is_prepared:
        return
    with make_progress() as bar:
        task = bar.add_task("exact torque and field", total=None, visible=False)

        def report(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total, visible=True)

        device.prepare(report)


@contextmanager
def time_bar(title: str, seconds: float) -> Iterator[Callable[[float], None]]:
    """A bar that fills within so many seconds; returns a function to call with the time passed [s].

    Nothing is drawn where standard error is not a terminal. A plain line, drawn twice a second by the thread that
    reports the time: a fine one takes milliseconds, or a thread that holds the interpreter, and a thread with a
    watchdog waits.
    """
    screen = sys.stderr
    if not screen.isatty():
        yield lambda more: None
        return
    total = drawn = 0.0

    def advance(more: float) -> None:
        nonlocal total, drawn
        total += more
        if total - drawn >= _DRAWN:
            drawn = total
            full = round(_WIDTH * min(total / seconds, 1.0))
            screen.write(f"\r    {title} {'━' * full}{' ' * (_WIDTH - full)} {max(seconds - total, 0.0):4.0f} s ")
            screen.flush()

    try:
        yield advance
    finally:
        screen.write("\r\033[K")
        screen.flush()
