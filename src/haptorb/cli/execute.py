"""`haptorb exec`: run a program written for another maker's library on a device; `haptorb libraries`."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Annotated

import typer

from haptorb.errors import DriverError, InputError
from haptorb.files import private_temporary_folder
from haptorb.runtime.linux import Termination, die_with_parent, require_linux, run_uninterrupted, start_python
from haptorb.terminal import echo, notify

__all__ = ["register"]

_EXIT_TIMEOUT_S = 2.0  #: time for the program to exit after its device has gone [s]
_CLOSE_TIMEOUT_S = 20.0  #: time for the run to exit, its recording included [s]


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""
    app.command("exec", context_settings={"ignore_unknown_options": False})(run_program)
    app.command("libraries")(libraries)


def libraries(
    folder: Annotated[Path, typer.Argument(help="Folder to put them into; made if it is not there.")],
    force: Annotated[bool, typer.Option("--force", help="Replace the files of the same names.")] = False,
) -> None:
    """Put libdrd, libdhd, libHD and their headers into a folder, for a build: DIR/lib, DIR/include."""
    require_linux("`haptorb libraries`")
    from haptorb.serve.native_libraries import lay_out

    lay_out(folder, replace=force)
    echo(f"{folder / 'lib'}: libdrd, libdhd and libHD; {folder / 'include'}: dhdc.h, drdc.h, HD/hd.h")
    echo(f"C and C++: cc program.c -I{folder / 'include'} -L{folder / 'lib'} -ldrd -lpthread -lm")
    echo(f"programs that look for a kit: FDSDK={folder}, LD_LIBRARY_PATH={folder / 'lib'}")


def run_program(
    command: Annotated[list[str], typer.Argument(metavar="-- PROGRAM ARGS", help="Program and its arguments.")],
    device: Annotated[str, typer.Option(help="Device name, or path of a device file.")] = "omni",
    world: Annotated[
        str | None, typer.Option(help="World beside the program's force (default: the program's force alone).")
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="World parameter, NAME=VALUE; repeatable.")
    ] = None,
    scale: Annotated[
        float | None, typer.Option(help="Metres for the program of one metre of the tool (default: 1; 10 on a motor).")
    ] = None,
    render: Annotated[
        str | None, typer.Option(help="Part of the program's wrench to render: force, torque or both, as of `run`.")
    ] = None,
    driver: Annotated[str, typer.Option(help="Driver: sim, serial:PORT or i2c:BUS.")] = "sim",
    tracker: Annotated[str | None, typer.Option(help="Source of the tool pose, as of `haptorb run`.")] = None,
    hand: Annotated[
        Path | None,
        typer.Option(
            help="Motion of the simulated hand, from when the program opens the device: a CSV file, a script or a "
            "recording (MCAP)."
        ),
    ] = None,
    rate: Annotated[float | None, typer.Option(help="Loop rate [Hz].")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of a simulated device.")] = None,
    record: Annotated[Path | None, typer.Option(help="Record to this MCAP file.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Let --record replace an existing file.")] = False,
    headless: Annotated[bool, typer.Option("--headless", help="Run without the console.")] = False,
    port: Annotated[int, typer.Option(help="Port of the console; 0 takes any free port.")] = 8765,
    browser: Annotated[bool, typer.Option("--open", help="Open the console in the browser.")] = False,
) -> None:
    """Run a program for Force Dimension's or OpenHaptics' libraries, unmodified, on a simulated device or a real Omni.

    Device and console end with the program; the exit status is the program's, 128 and the signal if one ended it.
    """
    require_linux("`haptorb exec`")
    from haptorb.serve.native_libraries import lay_out
    from haptorb.serve.native_program_check import check_program

    check_program(command[0])
    options = ["run", device, "--serve", "native" if scale is None else f"native:{scale!r}", "--driver", driver]
    for name, value in (
        ("--world", world),
        ("--render", render),
        ("--tracker", tracker),
        ("--hand", hand),
        ("--hand-start", None if hand is None else "program"),
        ("--rate", rate),
        ("--seed", seed),
    ):
        options += [] if value is None else [name, str(value)]
    options += [word for one in settings or [] for word in ("--set", one)]
    options += [] if record is None else ["--record", str(record)]
    flags = {"--force": force, "--headless": headless, "--open": browser}
    options += [name for name, on in flags.items() if on]
    options += [] if headless else ["--port", str(port)]
    with private_temporary_folder("libraries") as kit:  # its libraries are loaded
        lay_out(kit)
        with _open_run(options) as run:
            status = run.execute(command, kit)
    if status:
        raise typer.Exit(status)


class _Run:
    """`haptorb run` in a child process; its standard error is passed on."""

    def __init__(self, options: list[str]) -> None:
        self._process = start_python(
            "haptorb.cli.execute", *options,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        )  # fmt: skip
        self._ready, self._ended, self._path = threading.Event(), threading.Event(), ""
        assert self._process.stderr is not None
        self._reader = threading.Thread(target=self._read, args=(self._process.stderr,), daemon=True)
        self._reader.start()

    def _read(self, lines: IO[bytes]) -> None:
        for line in lines:
            text = line.decode(errors="replace")
            if not self._path and text.startswith("native: "):
                self._path = text.removeprefix("native: ").strip()
                self._ready.set()
            else:
                sys.stderr.write(text)
                sys.stderr.flush()
        self._process.wait()
        self._ended.set()
        self._ready.set()

    def execute(self, command: list[str], kit: Path) -> int:
        """Run the program once the device is ready; return its exit status. DriverError if no device starts."""
        self._ready.wait()
        if not self._path:
            raise DriverError("the device did not start; the lines above say why")
        library = str(kit / "lib")
        before = os.environ.get("LD_LIBRARY_PATH", "")
        environment = {
            **os.environ, "LD_LIBRARY_PATH": f"{library}:{before}" if before else library, "FDSDK": str(kit),
            "HAPTORB_RUN": self._path,
        }  # fmt: skip
        try:
            program = subprocess.Popen(command, env=environment)
        except OSError as cause:
            raise InputError(f"'{command[0]}' cannot be started: {cause.strerror}") from cause
        try:
            while program.poll() is None and not self._ended.is_set():
                with suppress(subprocess.TimeoutExpired):
                    program.wait(0.1)
            if program.poll() is None:
                notify("the device has ended; the program is ended, too")
                self._end_program(program)
        except (KeyboardInterrupt, Termination):
            self.stop()  # coils off first; the program has already received the terminal's signal
            run_uninterrupted(lambda _: self._end_program(program))
            if program.returncode == 0:
                raise
        code = program.returncode
        return code if code >= 0 else 128 - code

    @staticmethod
    def _end_program(program: subprocess.Popen[bytes]) -> None:
        for end in (None, program.terminate, program.kill):
            if end is not None:
                end()
            with suppress(subprocess.TimeoutExpired):
                program.wait(_EXIT_TIMEOUT_S)
                return

    def stop(self) -> None:
        """Send the run its stop signal."""
        with suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGTERM)

    def end(self) -> None:
        """Stop the run and wait: coils off, recording complete."""
        self.stop()
        if not self._ended.wait(_CLOSE_TIMEOUT_S):
            self._process.kill()
        self._reader.join(1.0)


@contextmanager
def _open_run(options: list[str]) -> Iterator[_Run]:
    run = _Run(options)
    try:
        yield run
    finally:
        run_uninterrupted(lambda _: run.end())


if __name__ == "__main__":  # entry point of the child process, which must not outlive `haptorb exec`
    die_with_parent(signal.SIGTERM)
    from haptorb.cli import main

    sys.exit(main(sys.argv[1:]))
