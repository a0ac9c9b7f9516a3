"""The overview of a long recording, made in a process of its own with low priority: it reads gigabytes.

    python -m haptorb.web.overview_process FILE START END [--damaged]

`--damaged`: the viewer found damaged rows, which are left out here too. Each byte on its standard input pauses it for a
moment, because a user scrubs; it ends with its standard input. It writes pickled (rows done, rows in all, ranges,
events) to its standard output: first a sketch of one piece for each interval not yet done, then every second, and at
the end.
"""

from __future__ import annotations

import os
import pickle
import sys
import threading
import time
import warnings

import numpy as np

from haptorb.errors import HaptorbError, RecordingWarning
from haptorb.recording.recording import Recording
from haptorb.web.overview import BINS, OverviewBins

_PIECE = 4000  #: rows that are read at once
_SKETCH = 8  #: rows of an interval for the sketch
_REPORT_INTERVAL_S = 0.7  #: between two words [s]
_REST = 0.4  #: after a byte [s]


def main() -> None:
    """Look through all rows, and say how far it is."""
    if hasattr(os, "nice"):
        os.nice(10)
    rest = [0.0]  # until when
    threading.Thread(target=_listen, args=(rest,), daemon=True).start()
    answers = os.fdopen(os.dup(1), "wb")
    path, start, end = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RecordingWarning)  # the viewer names what is missing
            recording = Recording(path)
            if "--damaged" in sys.argv[4:]:
                recording.check()
        rows = len(recording)
        sketch = OverviewBins(recording, start, end)
        for first in np.linspace(0, max(rows - _SKETCH, 0), BINS, dtype=np.int64).tolist():
            sketch.add(first, min(first + _SKETCH, rows), events=False)
        _say(answers, (0, rows, sketch.ranges, []))
        whole, last = OverviewBins(recording, start, end), time.monotonic()
        for first in range(0, rows, _PIECE):
            whole.add(first, min(first + _PIECE, rows))
            while (left := rest[0] - time.monotonic()) > 0:
                time.sleep(left)
            if time.monotonic() - last > _REPORT_INTERVAL_S:
                last = time.monotonic()
                # What is not done yet is as the sketch has it.
                ranges = np.where(np.isnan(whole.ranges), sketch.ranges, whole.ranges)
                _say(answers, (first + _PIECE, rows, ranges, whole.events))
        _say(answers, (rows, rows, whole.ranges, whole.events))
    except HaptorbError as cause:
        _say(answers, str(cause))
    except BrokenPipeError:
        os._exit(0)  # no reader is left


def _listen(rest: list[float]) -> None:
    with os.fdopen(os.dup(0), "rb", buffering=0) as wishes:
        while wishes.read(64):
            rest[0] = time.monotonic() + _REST
    os._exit(0)  # the server is gone


def _say(answers: object, what: object) -> None:
    pickle.dump(what, answers)  # type: ignore[arg-type]
    answers.flush()  # type: ignore[attr-defined]


if __name__ == "__main__":
    main()
