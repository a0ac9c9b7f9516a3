"""Recorder process: `python -m haptorb.runtime.recorder_process SPEC`.

It polls the ring buffer about fifty times a second, so a slow disk never delays the loop. It ends shortly after the
servo, however that has ended, and drains the ring buffer first. Its imports are few: it must be ready before the
first tick.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import select
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from time import sleep
from typing import Any

from haptorb.files import describe_size_limit
from haptorb.recording.destination import complete
from haptorb.recording.mcap import Recorder
from haptorb.recording.state_notes import LAYOUT_NOTE, STATE_NOTE, describe_arrays, pack_arrays
from haptorb.runtime.linux import END_SIGNALS, KillTimer, end_group, is_parent_gone, is_running
from haptorb.runtime.report import read_servers
from haptorb.runtime.shared_memory import REGULAR, Phase, SharedMemory, Word, split_snapshot

__all__ = ["main"]

_POLL_INTERVAL_MS = 20  #: [ms]
_WATCHDOG_TIMEOUT_S = 30.0  #: watchdog timeout: without a poll for this long the kernel kills the process


def main(spec: Mapping[str, Any]) -> int:
    """Record until the servo has ended; returns the exit code.

    `spec`: shared (path), file (descriptor of the open file, or its path), servo and parent (process ids), rate [Hz],
    unix_minus_monotonic [ns], notes (name → texts), temporary (path to remove if the parent is gone, or null).
    """
    for number in END_SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # it ends after the servo; until then rows are recorded
    shared = SharedMemory(Path(spec["shared"]))
    try:
        _record(shared, spec)
    except Exception as cause:
        reason = str(cause)
        if isinstance(cause, OSError) and cause.errno == errno.EFBIG:
            reason = f"{cause.strerror}; {describe_size_limit()}"
        shared.recorder_reason.write(reason[:4000])
        shared.words[Word.RECORDER] = Phase.FAILED
        return 1
    finally:
        if is_parent_gone(spec["parent"]):
            end_group(spec["servo"])
            shared.unlink()
            if spec["temporary"]:
                Path(spec["temporary"]).unlink(missing_ok=True)
    shared.words[Word.RECORDER] = Phase.ENDED
    return 0


def _record(shared: SharedMemory, spec: Mapping[str, Any]) -> None:
    words = shared.words
    with open(spec["file"], "wb") as file:
        recorder = Recorder(file, shared.layout, spec["rate"], spec["unix_minus_monotonic"])
        for name, values in spec["notes"].items():
            recorder.add_metadata(name, values)
        file.flush()
        words[Word.RECORDER] = Phase.RUNNING
        cursor = worlds = lost = errors = states = left_out = 0
        servo, timer = _ProcessExit(spec["servo"]), KillTimer()
        last = described = False
        programs: dict[tuple[str, str], dict[str, str]] = {}
        while True:
            words[Word.RECORDER_LOOKS] += 1
            timer.set(_WATCHDOG_TIMEOUT_S)
            last = servo.wait(_POLL_INTERVAL_MS) or words[Word.PHASE] >= Phase.ENDED
            for number, text in shared.worlds_since(worlds):
                recorder.add_metadata("world", {"change": str(number), "tick": str(words[Word.TICKS]), "world": text})
                worlds = number + 1
            if shared.error.version != errors:
                errors, text = shared.error.read()
                if text:
                    recorder.add_metadata("error", {"tick": str(words[Word.TICKS]), "text": text})
            _note_programs(recorder, shared, programs)
            for number, tick, snapshot in shared.states.read_since(states, REGULAR):
                states = number
                if words[Word.RECORDING_PAUSED]:
                    continue
                arrays = split_snapshot(shared.states.layout.read()[1], snapshot)
                if not described:
                    recorder.add_metadata(LAYOUT_NOTE, {"arrays": describe_arrays(arrays)})
                    described = True
                recorder.add_metadata(STATE_NOTE, {"tick": str(tick), "arrays": pack_arrays(arrays)})
            before = cursor
            cursor, rows = shared.ring.read_since(cursor)
            gap = cursor - before - len(rows)
            # After the rows were read: rows that are published after the pause are recorded.
            if words[Word.RECORDING_PAUSED]:
                if not left_out:
                    recorder.add_metadata("pause", {"after": str(recorder.written)})
                left_out += gap + len(rows)
                words[Word.TAKEN] = cursor
                if not last:
                    continue
                gap, rows = 0, rows[:0]
            if left_out:
                recorder.add_metadata("resume", {"rows": str(left_out), "after": str(recorder.written)})
                left_out = 0
            if gap:
                recorder.add_metadata("gap", {"rows": str(gap), "after": str(recorder.written)})
                lost += gap
            words[Word.LOST], words[Word.TAKEN] = lost, cursor
            recorder.append(rows)
            words[Word.WRITTEN] = recorder.safe_rows
            if last and not len(rows):
                break
        reason = shared.reason.read()[1]
        recorder.add_metadata("end", {"rows": str(recorder.written), "lost": str(lost), "reason": reason})
        recorder.finish()
        words[Word.WRITTEN] = recorder.safe_rows
        # Only a complete recording may be overwritten; a truncated one stays write-protected.
        complete(file.fileno(), temporary=bool(spec["temporary"]))


def _note_programs(recorder: Recorder, shared: SharedMemory, known: dict[tuple[str, str], dict[str, str]]) -> None:
    """Add a note for each program that has begun or ceased to command since the last call."""
    for server in read_servers(shared):
        for hold in server.get("programs", ()):
            note = {
                "server": str(server["server"]),
                **{key: "" if one is None else str(one) for key, one in hold.items()},
            }
            key = note["server"], note["session"]
            if known.get(key) != note and note["name"]:
                recorder.add_metadata("program", note)
                known[key] = note


class _ProcessExit:
    """Waits for the end of a process that is not a child of this one, also of one that was not reaped yet."""

    def __init__(self, pid: int) -> None:
        self._pid, self._ended = pid, False
        self._poll: select.poll | None = None
        if not hasattr(os, "pidfd_open"):
            return
        self._poll = select.poll()
        try:
            self._poll.register(os.pidfd_open(pid), select.POLLIN)
        except ProcessLookupError:
            self._ended = True

    def wait(self, milliseconds: int) -> bool:
        """Wait for at most `milliseconds`; True as soon as the process has ended."""
        if self._poll is not None:
            self._ended = self._ended or bool(self._poll.poll(milliseconds))
        else:
            sleep(1e-3 * milliseconds)
            self._ended = self._ended or not is_running(self._pid)
        return self._ended


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        sys.exit(main(json.load(sys.stdin.buffer)))
