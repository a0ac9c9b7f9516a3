"""Entry point of a server process: `python -m haptorb.serve.server_process`, with its settings on standard input.

Clients cannot delay the loop: it only reads what this process has written into the shared memory.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import traceback
from pathlib import Path
from types import FrameType
from typing import Any

from haptorb.child_process import unpack
from haptorb.errors import HaptorbError
from haptorb.runtime.linux import END_SIGNALS, die_with_parent
from haptorb.runtime.shared_memory import Phase, SharedMemory, Word
from haptorb.serve.base import ServedDevice, load_kind

__all__ = ["main"]


def main(spec: dict[str, Any]) -> int:
    """Serve until the servo ends; returns the exit code.

    `spec`: shared (path), slot, parent (process id), kind, given (the preparation's spec), descriptors (open sockets),
    device (Device), facts (of the run).
    """
    for number in END_SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # this process ends with the servo instead, or by the host's SIGTERM
    die_with_parent()
    shared = SharedMemory(Path(spec["shared"]))
    served = ServedDevice(shared, spec["slot"], spec["parent"], spec["device"], spec["facts"])

    def end(number: int, frame: FrameType | None) -> None:
        served.ending = True

    signal.signal(signal.SIGTERM, end)
    phase = Word.SERVERS + int(spec["slot"])
    try:
        kind = load_kind(spec["kind"])
        gc.collect()
        gc.freeze()  # else garbage collection over all loaded modules would delay a reply
        shared.words[phase] = Phase.RUNNING
        kind.serve(spec["given"], spec["descriptors"], served)
    except Exception as cause:
        text = str(cause) if isinstance(cause, HaptorbError) else "".join(traceback.format_exception(cause))
        sys.stderr.write(text)
        shared.words[phase] = Phase.FAILED
        return 1
    finally:
        served.conclude()
    shared.words[phase] = Phase.ENDED
    return 0


if __name__ == "__main__":
    number = main(unpack(sys.stdin.buffer.read()))
    sys.stderr.flush()
    os._exit(number)  # threads of a server's library must not keep the process alive
