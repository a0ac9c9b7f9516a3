"""The system clock is changed while a loop runs, by a day forwards and two back, without any effect.

A library between haptorb and the C library shifts CLOCK_REALTIME for all its processes; the shift stands in a file.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from haptorb.recording.recording import Recording

SHIM = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
static volatile long *shift;
static int (*get)(clockid_t, struct timespec *);
__attribute__((constructor)) static void begin(void) {
    get = dlsym(RTLD_NEXT, "clock_gettime");
    int file = open(getenv("CLOCK_SHIFT"), O_RDONLY);
    shift = mmap(0, sizeof(long), PROT_READ, MAP_SHARED, file, 0);
}
int clock_gettime(clockid_t clock, struct timespec *now) {
    int code = get(clock, now);
    if (clock == CLOCK_REALTIME) now->tv_sec += *shift;
    return code;
}
int gettimeofday(struct timeval *now, void *zone) {
    struct timespec t;
    int code = clock_gettime(CLOCK_REALTIME, &t);
    now->tv_sec = t.tv_sec, now->tv_usec = t.tv_nsec / 1000;
    return code;
}
time_t time(time_t *out) {
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    if (out) *out = t.tv_sec;
    return t.tv_sec;
}
"""
STEPS = (86_400, -86_400, 0)  #: [s]


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")
def test_a_clock_that_is_set_changes_nothing(tmp_path: Path) -> None:
    (tmp_path / "shim.c").write_text(SHIM)
    library = tmp_path / "shim.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, tmp_path / "shim.c", "-ldl"], check=True)
    file = tmp_path / "shift"
    file.write_bytes(bytes(8))
    shift = np.memmap(file, np.int64, "r+", shape=(1,))
    environment = {**os.environ, "LD_PRELOAD": str(library), "CLOCK_SHIFT": str(file)}
    shift[0] = STEPS[0]
    said = subprocess.run(
        [sys.executable, "-c", "import time; print(time.time())"], env=environment, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    assert float(said.stdout) > time.time() + 80_000  # it does shift the clock of a process
    shift[0] = 0
    recording = tmp_path / "run.mcap"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    program = subprocess.Popen(
        [sys.executable, "-P", "-m", "haptorb", "run", "omni", "--headless", "--duration", "4", "--json",
         "--record", str(recording), "--serve", f"osc:127.0.0.1:{port}"],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        deadline = time.monotonic() + 60.0
        while not (recording.exists() and recording.stat().st_size > 20_000):  # it runs
            assert time.monotonic() < deadline
            assert program.poll() is None
            time.sleep(0.02)
        for step in STEPS:
            shift[0] = step
            time.sleep(0.5)
        out, errors = program.communicate(timeout=60)
    finally:
        program.kill()
        program.communicate()
    assert program.returncode == 0, errors
    report = json.loads(out)
    assert report["trip_count"] == 0, report["trips"]
    t = np.asarray(Recording(recording)["t"])
    assert 1.5 < t[-1] - t[0] < 60.0
    assert np.diff(t)[:-1].min() > 0.0  # the last row says that the coils are off, at the time of the one before
    assert np.diff(t).max() < 0.2
