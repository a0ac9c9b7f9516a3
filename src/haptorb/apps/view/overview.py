"""The overview of a recording as the page gets it: at once for a short one, for a long one as far as it is."""

from __future__ import annotations

import json
import math
import os
import pickle
import struct
import subprocess
import threading
import time
from contextlib import suppress
from typing import Any, final

import numpy as np

from haptorb.apps.view.overview_bins import BINS, CHANNELS, OverviewBins
from haptorb.runtime.realtime.process_starter import start_python
from haptorb.runtime.recording.recording import Recording

__all__ = ["Overview"]

_PATIENCE = 1.0  #: for the process to end [s]
_OFTEN = 0.1  #: between two wishes that it rest [s]


@final
class Overview:
    """Made by `start`; `close` ends the process of a long recording, if it still runs.

    start, end: first and last time of the recording on the loop's clock [s]
    """

    def __init__(self, recording: Recording, start: float, end: float) -> None:
        self._recording, self._start, self._end = recording, start, end
        self._rows = len(recording)
        self._done, self._trouble = 0, ""
        self._ranges = np.full((len(CHANNELS), 2, BINS), np.nan)
        self._events: list[tuple[str, float, float]] = []
        self._process: subprocess.Popen[bytes] | None = None
        self._started = False
        self._asked = -math.inf  # when it was to give way

    def start(self) -> None:
        """Start, unless it has started."""
        if self._started:
            return
        self._started = True
        if not self._recording.long:
            bins = OverviewBins(self._recording, self._start, self._end)
            bins.add(0, self._rows)
            self._done, self._ranges, self._events = self._rows, bins.ranges, bins.events
            return
        arguments = [str(self._recording.path), repr(self._start), repr(self._end)]
        arguments += ["--damaged"] if self._recording.missing else []
        self._process = start_python(
            "haptorb.apps.view.overview_process", *arguments,
            isolated=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        threading.Thread(target=self._listen, args=(self._process,), daemon=True).start()

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        with process.stdout as answers, suppress(EOFError, OSError, ValueError, pickle.UnpicklingError):
            while True:
                answer = pickle.load(answers)
                if isinstance(answer, str):
                    self._trouble = answer
                    return
                self._done, _, self._ranges, self._events = answer
        process.wait()
        if self._done < self._rows and not self._trouble:
            self._trouble = "the process that computes the overview ended"

    def give_way(self) -> None:
        """Pause a process at work for a moment: scrubbing needs the processors more."""
        process, now = self._process, time.monotonic()
        if process is None or process.stdin is None or self._done >= self._rows or now < self._asked + _OFTEN:
            return
        self._asked = now
        with suppress(OSError, ValueError):
            os.write(process.stdin.fileno(), b".")

    def close(self) -> None:
        """End the process, if there is one."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        with suppress(OSError):
            process.stdin.close()
        process.terminate()
        try:
            process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def encode(self) -> bytes:
        """The length of a JSON text (uint32, little-endian), that text padded to four bytes, and (channels, 2, bins)
        float32: least and greatest in the unit of each channel.

        The text: rows `done` of `rows`, `trouble`, `bins`, names and units of `channels`, `events` with their time
        after the first tick [s].
        """
        description: dict[str, Any] = {
            "done": min(self._done, self._rows),
            "rows": self._rows,
            "trouble": self._trouble,
            "bins": BINS,
            "channels": [{"name": name, "unit": unit} for name, unit, *_ in CHANNELS],
            "events": [{"kind": kind, "t": t - self._start, "code": code} for kind, t, code in self._events],
        }
        text = json.dumps(description, allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        with np.errstate(over="ignore"):
            return struct.pack("<I", len(text)) + text + self._ranges.astype("<f4").tobytes()
