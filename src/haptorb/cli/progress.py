"""Progress bars for operations that take longer than a second: table computation, calibration steps."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from haptorb.devices.base import Device
from haptorb.terminal import make_progress

__all__ = ["build_tables", "time_bar"]

_BAR_CHARACTERS = 40  #: width of a bar in characters
_MIN_UPDATE_S = 0.5  #: least interval between two updates of a bar, by the reported time [s]


def build_tables(device: Device) -> None:
    """Build the tables of `device` if it has any, with a progress bar on standard error as the exact model runs.

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
    """Show a bar that fills within `seconds`; yield a function that takes the elapsed time [s].

    Nothing is drawn unless standard error is a terminal. The bar is a plain line, drawn twice a second by the calling
    thread: an elaborate one takes milliseconds, or a second thread that holds the interpreter lock, while the caller
    must serve a watchdog.
    """
    screen = sys.stderr
    if not screen.isatty():
        yield lambda more: None
        return
    total = drawn = 0.0

    def advance(more: float) -> None:
        nonlocal total, drawn
        total += more
        if total - drawn >= _MIN_UPDATE_S:
            drawn = total
            full = round(_BAR_CHARACTERS * min(total / seconds, 1.0))
            screen.write(
                f"\r    {title} {'━' * full}{' ' * (_BAR_CHARACTERS - full)} {max(seconds - total, 0.0):4.0f} s "
            )
            screen.flush()

    try:
        yield advance
    finally:
        screen.write("\r\033[K")
        screen.flush()
