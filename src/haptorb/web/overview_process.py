"""Overview of a long recording, computed in a separate process with low priority, because it reads gigabytes.

    python -m haptorb.web.overview_process FILE START END [--damaged]

`--damaged`: the viewer found damaged rows, which are skipped here too. Each byte on standard input pauses it for a
moment while a user scrubs; it ends at end of file. It writes pickled (rows done, rows in total, ranges, events) to
standard output: first a sketch from a few rows of each interval, then about every second, and at the end.
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
from haptorb.runtime.linux import lower_share
from haptorb.web.overview import BINS, OverviewBins

_ROWS_PER_READ = 4000  #: rows read at once
_SKETCH_ROWS = 8  #: rows per interval for the sketch
_REPORT_INTERVAL_S = 0.7  #: between two progress messages [s]
_PAUSE_S = 0.4  #: pause per byte received [s]


def main() -> None:
    """Read all rows and write the overview with its progress."""
    if hasattr(os, "nice"):
        lower_share(10)
    paused_until = [0.0]  # [s]
    threading.Thread(target=_receive_pauses, args=(paused_until,), daemon=True).start()
    answers = os.fdopen(os.dup(1), "wb")
    path, start, end = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RecordingWarning)  # the viewer reports missing rows
            recording = Recording(path)
            if "--damaged" in sys.argv[4:]:
                recording.check()
        rows = len(recording)
        sketch = OverviewBins(recording, start, end)
        for first in np.linspace(0, max(rows - _SKETCH_ROWS, 0), BINS, dtype=np.int64).tolist():
            sketch.add(first, min(first + _SKETCH_ROWS, rows), events=False)
        _write(answers, (0, rows, sketch.ranges, []))
        whole, last = OverviewBins(recording, start, end), time.monotonic()
        for first in range(0, rows, _ROWS_PER_READ):
            whole.add(first, min(first + _ROWS_PER_READ, rows))
            while (left := paused_until[0] - time.monotonic()) > 0:
                time.sleep(left)
            if time.monotonic() - last > _REPORT_INTERVAL_S:
                last = time.monotonic()
                # Intervals not read yet are taken from the sketch.
                ranges = np.where(np.isnan(whole.ranges), sketch.ranges, whole.ranges)
                _write(answers, (first + _ROWS_PER_READ, rows, ranges, whole.events))
        _write(answers, (rows, rows, whole.ranges, whole.events))
    except HaptorbError as cause:
        _write(answers, str(cause))
    except BrokenPipeError:
        os._exit(0)  # no reader is left


def _receive_pauses(paused_until: list[float]) -> None:
    with os.fdopen(os.dup(0), "rb", buffering=0) as requests:
        while requests.read(64):
            paused_until[0] = time.monotonic() + _PAUSE_S
    os._exit(0)  # the server is gone


def _write(answers: object, message: object) -> None:
    pickle.dump(message, answers)  # type: ignore[arg-type]
    answers.flush()  # type: ignore[attr-defined]


if __name__ == "__main__":
    main()
