"""Run the tests in three calls of pytest: what runs beside a clock, in threes; then what needs a browser as well, which
draws on every processor, in twos; and beside both what only computes, which gives way to them and has the processors
alone when they have ended.

    run_tests.py [--markers EXPRESSION] [pytest's arguments]

Before them, and only if all tests are wanted, two processes compile the kernels and the tests: else every
process of a call would compile them for itself.
The last line is pytest's summary of all calls together. The exit code is 0 only if none of them found a failure.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PYTEST = [sys.executable, "-m", "pytest", "--continue-on-collection-errors"]
BY_GROUP = ["--dist", "loadscope", "--no-loadscope-reorder"]
#: one more than processors, because a quarter of the time of these tests is waiting, and four at the most; the tests of
#: a file stay together, in the order of tests/conftest.py
SHARED = ["-n", str(min((os.cpu_count() or 1) + 1, 4)), *BY_GROUP]
#: loops at 1 kHz, and one emulated board at a time: each needs a fraction of a processor and mostly waits
IN_THREES = ["-n", "3", *BY_GROUP]
#: a page draws with a third of two processors, and the rest of a test waits for it; in the background, mypy is one half
IN_TWOS = ["-n", "2", *BY_GROUP]
#: in turn, the last one beside all others
CALLS: tuple[tuple[str, list[str]], ...] = (
    ("realtime and not browser", IN_THREES),
    ("realtime and browser", IN_TWOS),
    ("not realtime", SHARED),
)
#: what both processors do before all calls; each is a list of programs, one after the other. The calls beside a clock
#: begin after the first, the one in the background after the second, which takes less time.
COLLECT = [*PYTEST, "--collect-only", "-qq", "-m", CALLS[-1][0]]
COMPILE = [sys.executable, str(Path(__file__).with_name("compile_kernels.py"))]
PREPARATIONS = ([[*COMPILE, "omni", "planar"]], [COLLECT, [*COMPILE, "pmsm"]])
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


def start_pytest(arguments: list[str]) -> subprocess.Popen[bytes]:
    """One call."""
    command = [*PYTEST, *(["--color=yes"] if sys.stdout.isatty() else []), *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE)


def start_preparing() -> list[threading.Thread]:
    """Fill the caches of numba and Python. What fails here fails in a test, too, and is reported there."""

    def run(programs: list[list[str]]) -> None:
        for program in programs:
            subprocess.run(program, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)

    print("Compiling kernels and tests (half a minute) ...", flush=True)
    threads = [threading.Thread(target=run, args=[programs]) for programs in PREPARATIONS]
    for thread in threads:
        thread.start()
    return threads


def wants_all(words: list[str]) -> bool:
    """Whether pytest's arguments leave out no test: no path, no choice by name."""
    return all(word.startswith("--") and not word.startswith(("--lf", "--last", "--deselect")) for word in words)


def give_way() -> None:
    """Whatever else wants a processor has it. Linux may share them between sessions first, then between processes."""
    os.nice(19)
    with suppress(OSError):
        Path("/proc/self/autogroup").write_text("19")


@contextmanager
def run_in_the_background(arguments: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """One call in what time the others leave, in a session of its own; it ends with the block."""
    command = [*PYTEST, *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True, preexec_fn=give_way) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGTERM)


def show_pytest(process: subprocess.Popen[bytes]) -> tuple[int, Counter[str]]:
    """Show a call from its beginning to its end. Returns its exit code and what it counted."""
    output = b""
    with process:
        assert process.stdout is not None
        while chunk := os.read(process.stdout.fileno(), 65536):
            sys.stdout.buffer.write(chunk)
            sys.stdout.buffer.flush()
            output = (output + chunk)[-100_000:]
    counts = count_outcomes(output.decode("utf-8", "replace"))
    return process.returncode or int(counts["failed"] + counts["error"] > 0), counts


def combine_codes(codes: list[int]) -> int:
    """0 if all calls passed; a call without tests counts only where no call had any."""
    return next((code for code in codes if code not in (0, NO_TESTS)), min(codes))


def main(words: list[str]) -> int:
    markers = ""
    if words[:1] == ["--markers"]:
        markers, words = f" and ({words[1]})", words[2:]
    start = time.monotonic()
    threads = start_preparing() if wants_all(words) else []
    *calls, last = (["-m", which + markers, *how, *words] for which, how in CALLS)
    for thread in threads[1:]:
        thread.join()
    with run_in_the_background(last) as background:
        for thread in threads[:1]:
            thread.join()
        outcomes = [show_pytest(start_pytest(call)) for call in calls]
        outcomes.append(show_pytest(background))
    counts = sum((counted for _, counted in outcomes), Counter[str]())
    print("\n" + format_summary(counts, time.monotonic() - start), flush=True)
    return combine_codes([code for code, _ in outcomes])


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit(130)
