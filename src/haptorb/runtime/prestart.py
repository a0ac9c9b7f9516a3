"""Standby servo process: started early, it loads what any servo needs, and waits for its plan.

Half of a start is loading packages and compiled code. A program that knows early that it will need a servo, and has
other work first (read a device file, check a world), starts this before; on two processors both run in parallel.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from types import TracebackType
from typing import Self, final

from haptorb.child_process import environment
from haptorb.errors import ServoError
from haptorb.files import create_private_folder
from haptorb.runtime.linux import start_python

__all__ = ["CATALOGUE", "CONTROLLER", "PLAN", "WANTED", "PrestartedProcess", "code_note", "start_module"]

PLAN = "plan"  #: name of the file in the folder
CONTROLLER, CATALOGUE = "controller", "catalogue"  #: what a compiler process (`first_start`) compiles
WANTED = "wanted"  #: name of the file that names the requested world


@final
class PrestartedProcess:
    """The process, and a folder for data exchanged with it. It has no access to coils until `activate`.

    Ends with the `with` block unless it was activated; then it belongs to the servo.
    """

    def __init__(self) -> None:
        self.folder, self.claim = create_private_folder("servo")  #: owned by the servo from `activate` on
        self.errors = self.folder / "errors"  #: standard error of the process
        self.given = False
        try:
            self.process = start_module(
                "haptorb.runtime.servo_process", str(self.folder), str(os.getpid()), errors=self.errors,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            )  # fmt: skip
        except BaseException:
            self._tidy()
            raise

    @property
    def plan(self) -> Path:
        """The plan file, to be written before `activate`. Raises ServoError if the process is in use already."""
        if self.given:
            raise ServoError("this prestarted process serves another servo, or has ended; create a new one")
        return self.folder / PLAN

    def activate(self, shared: Path) -> None:
        """Start the servo with the plan that was written and the shared memory `shared`."""
        self.given = True
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(os.fsencode(shared))
            self.process.stdin.close()
        except BrokenPipeError:
            pass  # it has ended already: the wait for its first tick reports why

    def end(self) -> None:
        """End the process. May be called twice."""
        if self.given:
            return
        self.given = True
        self.process.kill()
        self.process.communicate()
        self._tidy()

    def _tidy(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        self.claim.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.end()


def code_note(folder: Path, name: str) -> Path:
    """Marker file in the servo's `folder`: it exists when the code of the catalogue's world `name` is compiled."""
    return folder / f"code-{name}"


def start_module(
    module: str,
    *arguments: str,
    errors: Path,
    stdin: int = subprocess.DEVNULL,
    stdout: int = subprocess.DEVNULL,
    descriptor: int | None = None,
    descriptors: tuple[int, ...] = (),
    isolated: bool = False,
) -> subprocess.Popen[bytes]:
    """As `start_python`; the standard error of the process is appended to `errors`.

    The process may use the parent-death signal: it is started by a thread that runs as long as the parent.
    """
    with errors.open("ab") as file:
        return start_python(
            module,
            *arguments,
            isolated=isolated,
            stdin=stdin,
            stdout=stdout,
            stderr=file,
            pass_fds=descriptors if descriptor is None else (descriptor, *descriptors),
            # Small matrices: a second thread of OpenBLAS would only busy-wait beside the servo's.
            env=environment({"OPENBLAS_NUM_THREADS": "1"}),
        )
