"""Server of the console: port, end, and page."""

from __future__ import annotations

import asyncio
import gzip
import os
import re
import shutil
import signal
import socket
import subprocess
import threading
import time

import numpy as np
import pytest

from haptorb.errors import InputError
from haptorb.web.console import STATIC, Console, application

BUDGET = 200_000  #: bytes of the whole page, compressed


def flat_map(name, values, model, points):
    return np.ones(len(points)), np.zeros(len(points), dtype=bool)


def test_taken_port_says_who_to_ask_and_what_to_do(servo):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=f"port {port} .* is in use.*ss -ltnp.*--port"):
            Console(servo, port, force_map=flat_map)


@pytest.mark.parametrize("port", [-1, 65536, 1.5, True, "8765"])
def test_impossible_port_is_refused(servo, port):
    with pytest.raises(InputError, match="port must be a whole number"):
        Console(servo, port, force_map=flat_map)


@pytest.mark.realtime
def test_ends_when_the_servo_ends(servo):
    with Console(servo, 0, force_map=flat_map) as console:
        serving = threading.Thread(target=console.serve)
        serving.start()
        time.sleep(0.2)
        servo.alive = False
        serving.join(10)
        assert not serving.is_alive()


@pytest.mark.realtime
def test_whatever_ends_the_server_the_coils_are_off_before_its_threads_end(servo):
    """The end of an event loop waits for the threads of its executor, such as one that has asked for another world."""
    free, off = threading.Event(), []

    def ask_for_a_world():
        free.wait(10.0)
        off.append(getattr(servo, "ended", False))

    def fail():
        asyncio.get_running_loop().run_in_executor(None, ask_for_a_world)
        threading.Timer(0.3, free.set).start()
        raise RuntimeError("a fault of the caller")

    with Console(servo, 0, force_map=flat_map) as console, pytest.raises(RuntimeError, match="fault of the caller"):
        console.serve(until=fail)
    assert off == [True]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.realtime
def test_ends_by_a_signal_and_tells_which(servo, number):
    before = signal.getsignal(number)
    timer = threading.Timer(0.5, os.kill, (os.getpid(), number))
    with Console(servo, 0, force_map=flat_map) as console:
        timer.start()
        assert console.serve() == number
    assert signal.getsignal(number) is before


@pytest.mark.realtime
def test_ends_when_told(servo):
    with Console(servo, 0, force_map=flat_map) as console:
        end = time.monotonic() + 0.3
        assert console.serve(until=lambda: time.monotonic() > end) is None


def test_page_that_was_not_built_says_how(servo, tmp_path, monkeypatch):
    monkeypatch.setattr("haptorb.web.console.STATIC", tmp_path)
    with pytest.raises(InputError, match="npm run build"):
        application(servo, flat_map)


def test_page_is_small():
    size = sum(len(gzip.compress(path.read_bytes())) for path in STATIC.iterdir() if path.suffix != ".txt")
    assert size < BUDGET


def test_page_names_no_other_computer():
    for path in STATIC.iterdir():
        if path.suffix in {".html", ".css"}:
            assert not re.findall(r"(?:src|href)=[\"']?(?:https?:)?//|url\([\"']?(?:https?:)?//", path.read_text())


def test_page_type_checks(root):
    tsc = root / "web" / "node_modules" / ".bin" / "tsc"
    if not tsc.exists() or shutil.which("node") is None:
        pytest.skip("the page's packages are not installed: run `npm ci` in web/")
    done = subprocess.run([tsc, "--noEmit"], cwd=root / "web", capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stdout


def test_lock_file_names_no_download_address(root):
    lock = (root / "web" / "package-lock.json").read_text()
    assert '"resolved"' not in lock
    assert lock.count('"integrity"') > 10
