"""Run the tests in three calls of pytest: what runs beside a clock comes in twos, what needs a browser as well follows
one by one, and what only computes takes the time of the processors that these two leave.

    run_tests.py [--markers EXPRESSION] [pytest's arguments]

The last line is pytest's summary of all calls together. The exit code is 0 only if none of them found a failure.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO

PYTEST = [sys.executable, "-m", "pytest", "--continue-on-collection-errors"]
#: four processes at the most; a file's tests stay together, in the order of tests/conftest.py; the others come first
SHARED = ["-n", "logical", "--maxprocesses", "4", "--dist", "loadscope", "--no-loadscope-reorder", "-o", "timeout=900"]
#: two loops at 1 kHz or emulated boards, each of which needs a fraction of a processor and mostly waits
IN_TWOS = ["-n", "2", "--dist", "loadscope", "--no-loadscope-reorder"]
ALONE = ["-n", "0"]
COMPUTING = ("not realtime", SHARED)
BESIDE_A_CLOCK = (("realtime and not browser", IN_TWOS), ("realtime and browser", ALONE))
NO_TESTS = 5  #: pytest's exit code where nothing was chosen: another call may have had something
ORDER = ("failed", "passed", "skipped", "xfailed", "xpassed", "warning", "error", "rerun")
_SUMMARY = re.compile(r"^(?:=+ )?((?:\d+ \w+(?:, )?)+|no tests ran) in [\d.]+s(?: \(.*\))?(?: =+)?$", re.MULTILINE)
_COUNT = re.compile(r"(\d+) (failed|passed|skipped|xfailed|xpassed|warning|error|rerun)")
_COLOUR = re.compile(r"\x1b\[[\d;]*m")


def count_outcomes(text: str) -> Counter[str]:
    """The numbers of pytest's last summary in `text`; one error if it has none, because then pytest did not end."""
    summaries = _SUMMARY.findall(_COLOUR.sub("", text).replace("\r", ""))
    if not summaries:
        return Counter({"error": 1})
    return Counter({word: int(number) for number, word in _COUNT.findall(summaries[-1])})


def format_summary(counts: Counter[str], seconds: float) -> str:
    """All counts as pytest writes them at its end."""
    summary = ", ".join(
        f"{counts[word]} {word}{'s' * (word in ('warning', 'error') and counts[word] > 1)}"
        for word in ORDER
        if counts[word]
    )
    minutes, rest = divmod(round(seconds), 60)
    took = f"{seconds:.2f}s ({minutes // 60}:{minutes % 60:02}:{rest:02})"
    # .ci/run looks for the signs, however long it is.
    return f"= {summary or 'no tests ran'} in {took} =".center(80, "=")


def list_command(arguments: list[str]) -> list[str]:
    """One call of pytest."""
    return [*PYTEST, *(["--color=yes"] if sys.stdout.isatty() else []), *arguments]


def run_pytest(arguments: list[str]) -> tuple[int, Counter[str]]:
    """One call, shown while it runs. Returns its exit code and what it counted."""
    with subprocess.Popen(list_command(arguments), stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        return wait_for(process, process.stdout)


@contextmanager
def yielding_pytest(arguments: list[str]) -> Iterator[tuple[subprocess.Popen[bytes], IO[bytes]]]:
    """One call that gets the processors only while nobody else wants them; the process, and its output so far."""
    with (
        tempfile.TemporaryFile() as written,
        subprocess.Popen(list_command(arguments), stdout=written, preexec_fn=yield_processor) as process,
        open(os.dup(written.fileno()), "rb") as output,
    ):
        try:
            yield process, output
        finally:
            if process.poll() is None:
                process.terminate()


def yield_processor() -> None:
    """Every other process comes first, from now on and for all that this one starts."""
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def wait_for(process: subprocess.Popen[bytes], source: IO[bytes]) -> tuple[int, Counter[str]]:
    """Show what `process` writes until it has ended. Returns its exit code and what it counted."""
    output, place, over = b"", 0, False
    while True:
        if source is process.stdout:
            chunk = os.read(source.fileno(), 65536)
        else:  # a file that grows
            over = process.poll() is not None
            chunk = os.pread(source.fileno(), 65536, place)
        if chunk:
            sys.stdout.buffer.write(chunk)
            sys.stdout.buffer.flush()
            output, place = (output + chunk)[-100_000:], place + len(chunk)
        elif over or source is process.stdout:
            break
        else:
            time.sleep(0.2)
    counts = count_outcomes(output.decode("utf-8", "replace"))
    return process.wait() or int(counts["failed"] + counts["error"] > 0), counts


def combine_codes(codes: list[int]) -> int:
    """0 if all calls passed; a call without tests counts only where no call had any."""
    return next((code for code in codes if code not in (0, NO_TESTS)), min(codes))


def main(words: list[str]) -> int:
    markers = ""
    if words[:1] == ["--markers"]:
        markers, words = f" and ({words[1]})", words[2:]
    start = time.monotonic()
    found = []
    which, how = COMPUTING
    with yielding_pytest(["-m", which + markers, *words, *how]) as (process, output):
        found += [run_pytest(["-m", which + markers, *words, *how]) for which, how in BESIDE_A_CLOCK]
        found.append(wait_for(process, output))
    codes, counts = [code for code, _ in found], sum((counted for _, counted in found), Counter[str]())
    print("\n" + format_summary(counts, time.monotonic() - start), flush=True)
    return combine_codes(codes)


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit(130)
