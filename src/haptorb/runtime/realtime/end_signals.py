"""The signals that end a program: Ctrl-C, SIGTERM, and SIGHUP of a terminal that is closed."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import final

__all__ = ["END_SIGNALS", "Termination", "hold_signals", "raise_termination"]

END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if hasattr(signal, "SIGHUP") else (signal.SIGINT,)


@final
class Termination(BaseException):
    """SIGTERM or SIGHUP on its way through `with` blocks that switch the coils off, as KeyboardInterrupt for SIGINT."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


@contextmanager
def raise_termination() -> Iterator[None]:
    """SIGTERM and SIGHUP raise Termination meanwhile, so that what is open is closed; one that is ignored (`nohup`)
    stays so. In the main thread; elsewhere nothing changes."""

    def end(number: int, frame: FrameType | None) -> None:
        raise Termination(number)

    with _handle(dict.fromkeys(END_SIGNALS[1:], end)):
        yield


@contextmanager
def hold_signals() -> Iterator[threading.Event]:
    """What is being tidied up is not interrupted: a signal that ends programs sets the event, and has its usual effect
    afterwards. In the main thread; elsewhere nothing changes."""
    held: list[int] = []
    event = threading.Event()

    def hold(number: int, frame: FrameType | None) -> None:
        held.append(number)
        event.set()

    with _handle(dict.fromkeys(END_SIGNALS, hold)):
        yield event
    if held:
        signal.raise_signal(held[0])


@contextmanager
def _handle(handlers: dict[signal.Signals, object]) -> Iterator[None]:
    before: dict[signal.Signals, object] = {}
    if threading.current_thread() is threading.main_thread():
        for number, handler in handlers.items():
            if (now := signal.getsignal(number)) not in (signal.SIG_IGN, None):  # None: not from Python, stays
                before[number] = now
                signal.signal(number, handler)  # type: ignore[arg-type]
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]
