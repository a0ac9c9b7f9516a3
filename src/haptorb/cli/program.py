"""The program `haptorb`: its commands and exit codes.

Exit codes: 0 success, 1 the command ran and its check failed, 2 user error explained by a message, 130 interrupted,
143, 129 and 131 ended by SIGTERM, SIGHUP and SIGQUIT.
"""

from __future__ import annotations

import errno
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Annotated, Any

import typer

from haptorb.cli import (
    calibrate,
    check,
    execute,
    fit_multipole,
    frame,
    hardware,
    keys,
    recording,
    replay,
    run,
    show,
    train,
    view,
)
from haptorb.database_address import has_password, mask_password
from haptorb.earlier_names import EarlierNameWarning
from haptorb.errors import HaptorbError, InputError, RecordingWarning
from haptorb.figure_file import ignore_local_settings
from haptorb.files import describe_size_limit, visible
from haptorb.runtime.linux import Termination, raise_termination
from haptorb.terminal import CommandLine, drop_output, echo, notify, open_output, use_ascii_fallback
from haptorb.version import __version__

__all__ = ["app", "main"]

_DISK_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  #: errors of a full disk, exceeded quota, too large file

app = CommandLine(
    name="haptorb",
    help="Design, simulate and run spherical electromagnetic haptic devices.",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def print_version(wanted: bool) -> None:
    """Print the version and exit, before other options are evaluated."""
    if wanted:
        echo(f"haptorb {__version__}")
        raise typer.Exit


@app.callback()
def start(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=print_version)
    ] = False,
) -> None:
    """Design, simulate and run spherical electromagnetic haptic devices."""


#: extra → packages that it installs and that commands import without a message of their own
_EXTRAS = {
    "study": ("sqlalchemy", "pyarrow", "psycopg", "pylsl"),
    "design": ("sqlalchemy", "tomli_w", "threadpoolctl", "pymoo"),
}
_REPOSITORY_PACKAGES = ("haptorb_bench", "haptorb_papers")  #: packages of the source repository that no wheel contains


def explain_missing(command: str, missing: ModuleNotFoundError) -> str:
    """Explain why `command` cannot run without the missing module, and what to install; "" if no extra installs it."""
    package = str(missing.name).partition(".")[0]
    if package in _REPOSITORY_PACKAGES:
        return f"`haptorb {command}` is part of the source repository, not of the installed package: run it in a clone"
    extras = [extra for extra, packages in _EXTRAS.items() if package in packages]
    if extras:
        extra = command if command in extras else extras[0]
        return f"`haptorb {command}` needs {package}, which is not installed: pip install 'haptorb[{extra}]'"
    return ""


_broken: list[str] = []  #: why each command that no extra would add cannot be loaded; shown with the list of commands


def _register_broken(point: EntryPoint, cause: BaseException) -> None:
    """Register a stub command that reports `cause`, of importing its package; all other commands stay available."""
    package = point.module.partition(".")[0]
    why = explain_missing(point.name, cause) if isinstance(cause, ModuleNotFoundError) else ""
    if not why:
        text = " ".join(f"{type(cause).__name__}: {cause}".split())
        why = f"`haptorb {point.name}`, of the package {package}, cannot be loaded: {visible(text)}"
        _broken.append(why)

    @app.command(point.name, hidden=True, context_settings={"ignore_unknown_options": True, "allow_extra_args": True})
    def explain() -> None:
        raise InputError(why)


for module in (
    run,
    execute,
    view,
    show,
    keys,
    check,
    recording,
    replay,
    calibrate,
    frame,
    fit_multipole,
    train,
    hardware,
):
    module.register(app)
for point in entry_points(group="haptorb.commands"):
    try:
        point.load().register(app)
    except (Exception, SystemExit) as cause:  # of a stranger's module
        _register_broken(point, cause)


@cache
def _command() -> Callable[..., Any]:
    """Build all commands with their options, once per process: it takes longer than most commands."""
    return typer.main.get_command(app)


@contextmanager
def report_remarks() -> Iterator[None]:
    """Report in one line on standard error what is missing in a recording, and a name of version 0.1."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", RecordingWarning)
        show = warnings.showwarning

        def show_remark(message: Warning | str, category: type[Warning], *others: Any, **more: Any) -> None:
            if issubclass(category, RecordingWarning | EarlierNameWarning):
                notify(str(message))
            else:
                show(message, category, *others, **more)

        warnings.showwarning = show_remark
        yield


def check_secrets(words: list[str]) -> None:
    """Raise InputError for a database address with a password: every account of the computer can read the arguments of
    a command (`ps`) while it runs."""
    for word in words:
        place = word.partition("=")[2] if word.startswith("--") else word
        if not place.startswith("postgres") or "://" not in place:
            continue
        if has_password(place):  # safety: no-password-in-words
            raise InputError(
                f"the address {mask_password(place)} holds a password, which every account of this computer can read "
                "in the list of processes; leave it out of the address and put it into ~/.pgpass (readable by you "
                "only) or into the environment variable PGPASSWORD, and choose another one"
            )


def _is_file_too_large(mistake: BaseException) -> bool:
    """Whether a file that may not become larger is a cause of `mistake`."""
    cause: BaseException | None = mistake
    while cause is not None and not (isinstance(cause, OSError) and cause.errno == errno.EFBIG):
        cause = cause.__cause__
    return cause is not None


def _is_no_temporary_folder(cause: OSError) -> bool:
    """Whether Python found no folder for temporary files, as where every folder is read-only."""
    return isinstance(cause, FileNotFoundError) and "temporary directory" in (cause.strerror or "")


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; a user error prints one message without a traceback."""
    open_output()
    use_ascii_fallback()
    try:
        words = sys.argv[1:] if arguments is None else arguments
        with raise_termination(), report_remarks():
            check_secrets(words)
            if not words or words[0] in ("-h", "--help"):
                for why in _broken:
                    notify(f"haptorb: {why}")
            if ignored := ignore_local_settings():
                notify(f"haptorb: {ignored}")
            _command()(args=arguments)
    except HaptorbError as mistake:
        limit = describe_size_limit() if _is_file_too_large(mistake) else ""
        already = not limit or limit in mistake.command_message
        notify(f"haptorb: {mistake.command_message}" + ("" if already else f"; {limit}"))
        return 2
    except ModuleNotFoundError as missing:
        named = [word for word in words if not word.startswith("-")]
        if not (why := explain_missing(named[0] if named else "", missing)):
            raise
        notify(f"haptorb: {why}")
        return 2
    except KeyboardInterrupt:
        return 130
    except Termination as end:
        return 128 + end.number
    except BrokenPipeError:  # `haptorb devices | head` is not an error
        sys.stderr.close()
    except OSError as cause:
        if _is_no_temporary_folder(cause):
            notify(
                "haptorb: no folder for temporary files can be written: neither $TMPDIR, /tmp, /var/tmp nor this one; "
                "set TMPDIR to a folder of yours that can"
            )
            return 2
        if cause.errno not in _DISK_FULL_ERRORS:
            raise
        drop_output()
        limit = describe_size_limit() if cause.errno == errno.EFBIG else ""
        notify(f"haptorb: cannot write {cause.filename or 'the output'}: {cause.strerror}" + (limit and f"; {limit}"))
        return 2
    return 0
