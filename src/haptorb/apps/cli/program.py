"""The program `haptorb`: its commands, and how it ends.

Exit codes: 0 done, 1 the command ran and its verdict is no, 2 a mistake that the message explains, 130 interrupted,
143 and 129 ended by SIGTERM and SIGHUP.
"""

from __future__ import annotations

import errno
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer

from haptorb.apps.cli import (
    calibrate,
    check,
    design,
    feel,
    fit,
    frame,
    hardware,
    recording,
    replay,
    run,
    show,
    study,
    train,
    view,
)
from haptorb.apps.cli.evaluation import bench, estimators, guidance, reproduce
from haptorb.apps.terminal import say, tell
from haptorb.apps.terminal.help_text import CommandLine
from haptorb.apps.terminal.output import drop_output, open_output
from haptorb.apps.terminal.spelling import use_ascii_fallback
from haptorb.errors import HaptorbError, RecordingWarning
from haptorb.runtime.realtime.end_signals import Termination, raise_termination
from haptorb.version import __version__

__all__ = ["app", "main"]

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  #: disk, quota, file

app = CommandLine(
    name="haptorb",
    help="Design, simulate and run spherical electromagnetic haptic devices.",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def tell_version(wanted: bool) -> None:
    """Print the version and end, before anything else is looked at."""
    if wanted:
        tell(f"haptorb {__version__}")
        raise typer.Exit


@app.callback()
def start(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=tell_version)
    ] = False,
) -> None:
    """Design, simulate and run spherical electromagnetic haptic devices."""


for module in (
    *(run, view, show, check, study, recording, replay, calibrate, frame, fit, train, estimators, guidance),
    *(design, bench, hardware, reproduce, feel),
):
    module.register(app)


@contextmanager
def report_damage() -> Iterator[None]:
    """Say on standard error, wherever a command opens a damaged recording, what is missing of it."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", RecordingWarning)
        show = warnings.showwarning

        def show_damage(message: Warning | str, category: type[Warning], *others: Any, **more: Any) -> None:
            if issubclass(category, RecordingWarning):
                say(str(message))
            else:
                show(message, category, *others, **more)

        warnings.showwarning = show_damage
        yield


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; a user's mistake is one message, never a traceback."""
    open_output()
    use_ascii_fallback()
    try:
        with raise_termination(), report_damage():
            app(args=arguments)
    except HaptorbError as mistake:
        say(f"haptorb: {mistake.command_message}")
        return 2
    except KeyboardInterrupt:
        return 130
    except Termination as end:
        return 128 + end.number
    except BrokenPipeError:  # `haptorb devices | head` is no mistake
        sys.stderr.close()
    except OSError as cause:
        if cause.errno not in _FULL:
            raise
        drop_output()
        say(f"haptorb: cannot write {cause.filename or 'the output'}: {cause.strerror}")
        return 2
    return 0
