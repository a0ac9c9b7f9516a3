"""Processing of untrusted files in a separate process with limits on time, memory and output."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

__all__ = ["ProcessFailure", "run_limited", "set_limits"]


class ProcessFailure(Exception):
    """The program failed; the message is one sentence in which "it" is the file."""


def run_limited(
    program: Path, words: Sequence[str], folder: Path, seconds: int, memory: int, given: bytes = b""
) -> None:
    """Run the Python file `program`, which needs the standard library only and calls `set_limits`, in `folder`.

    seconds  processor time limit [s]; wall-clock limit: twice as much
    memory   limit [bytes]
    given    what it reads from its standard input

    It ignores Python's environment variables and the working directory. Raises ProcessFailure with its output if its
    exit code is not 0, or with the limit that it exceeded.
    """
    command = [sys.executable, "-I", "-S", str(program), str(seconds), str(memory), *words]
    try:
        done = subprocess.run(command, cwd=folder, input=given, capture_output=True, timeout=2 * seconds, check=False)
    except subprocess.TimeoutExpired as cause:
        raise ProcessFailure(f"it takes longer than {2 * seconds} s; make it smaller") from cause
    if done.returncode == 0:
        return
    said = " ".join((done.stdout + done.stderr).decode("utf-8", "replace")[-2000:].split())
    if done.returncode in (-24, -9):  # SIGXCPU, then SIGKILL
        raise ProcessFailure(f"it takes longer than {seconds} s of the processor; make it smaller")
    if "allocate" in said or "bad_alloc" in said or "MemoryError" in said:
        raise ProcessFailure(f"it needs more than {memory >> 20} MiB of memory; make it smaller")
    if done.returncode < 0:
        raise ProcessFailure(f"it ended its reader with signal {-done.returncode}: it is damaged, or made to do that")
    raise ProcessFailure(said or "its reader ended without a message")


def set_limits(seconds: int, memory: int, largest: int) -> None:
    """Limit this process: processor time [s], memory and the size of a file that it writes [bytes]."""
    import resource  # not at the top: Windows lacks it

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))  # safety: compile-time
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))  # safety: compile-memory
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
