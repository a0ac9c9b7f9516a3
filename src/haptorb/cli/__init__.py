"""Command line `haptorb`. Each command is one file, which imports its dependencies when it runs."""

from __future__ import annotations

import signal
import sys
import threading
from types import TracebackType

__all__ = ["main"]


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; a user error prints one message without a traceback; ^C is handled at any time."""
    if arguments is None:  # this process is the program
        sys.excepthook = _print_unless_interrupted
    try:
        from haptorb.cli.program import main as run  # ^C may come before all of it is loaded

        return run(arguments)
    except KeyboardInterrupt:
        return 130
    except ImportError as failure:  # of a library in C++ whose loading a signal interrupted
        interruption = _find_interruption(failure)
        if interruption is None:
            raise
        return 128 + int(getattr(interruption, "number", signal.SIGINT))
    finally:
        if arguments is None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.SIG_DFL)  # ^C while the interpreter ends is silent, too


def _find_interruption(failure: BaseException) -> BaseException | None:
    """Return the exception of the signal (Ctrl-C, SIGTERM and others) that caused `failure`, if one did."""
    cause: BaseException | None = failure
    while isinstance(cause, Exception):
        cause = cause.__cause__ or cause.__context__
    return cause


def _print_unless_interrupted(kind: type[BaseException], cause: BaseException, trace: TracebackType | None) -> None:
    """Print an uncaught exception unless it is Ctrl-C: the exit code reports that."""
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, cause, trace)
