"""Printing while coils may be on: a terminal that does not read makes nobody wait."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest

from haptorb import terminal
from haptorb.runtime.world_output import show
from haptorb.terminal import echo, notify, queue_output

pytestmark = pytest.mark.skipif(os.name != "posix", reason="no such pipes")


class FullPipe:
    """Standard output and error that lead to a pipe without room."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.out, into = os.pipe()
        filler = os.open(f"/proc/self/fd/{self.out}", os.O_WRONLY | os.O_NONBLOCK)
        self.filled = 0
        with suppress(BlockingIOError):
            while True:
                self.filled += os.write(filler, b"." * 4096)
        os.close(filler)
        self.stream = io.TextIOWrapper(os.fdopen(into, "wb"), encoding="utf-8", line_buffering=True)
        self._monkeypatch = monkeypatch

    def connect(self) -> None:
        """From now on; in the test itself, as pytest replaces both before it."""
        for name in ("stdout", "stderr"):
            self._monkeypatch.setattr(sys, name, self.stream)

    def read(self) -> str:
        """All that comes until the other end is closed."""
        text = b""
        while part := os.read(self.out, 65536):
            text += part
        return text[self.filled :].decode()


@pytest.fixture
def pipe(monkeypatch: pytest.MonkeyPatch) -> Iterator[FullPipe]:
    made = FullPipe(monkeypatch)
    yield made
    made.stream.close()
    os.close(made.out)


def read_later(pipe: FullPipe) -> tuple[threading.Thread, list[str]]:
    """Somebody who reads after 0.2 s."""
    found = list[str]()

    def read() -> None:
        time.sleep(0.2)
        found.append(pipe.read())

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    return reader, found


@pytest.mark.realtime(retry=False)
@pytest.mark.timeout(30)
def test_printing_does_not_wait_and_nothing_is_lost(pipe: FullPipe) -> None:
    pipe.connect()
    with queue_output():
        before = time.monotonic()
        notify("one")
        echo("two")
        show("three\n")
        print("four", file=sys.stderr, flush=True)
        assert time.monotonic() - before < 0.5
        reader, found = read_later(pipe)
    assert sys.stderr is pipe.stream
    pipe.stream.close()
    reader.join(10)
    assert found == ["one\ntwo\nthree\nfour\n"]


@pytest.mark.timeout(30)
def test_what_nobody_reads_is_bounded_and_told(pipe: FullPipe, monkeypatch: pytest.MonkeyPatch) -> None:
    pipe.connect()
    monkeypatch.setattr(terminal, "_MAX_QUEUED_CHARACTERS", 1000)
    with queue_output():
        for n in range(300):
            notify(f"line {n:>4}")
        reader, found = read_later(pipe)
    pipe.stream.close()
    reader.join(10)
    assert len(found[0]) < 1200
    assert "2000 characters were left out: nobody read this output" in found[0]


@pytest.mark.timeout(30)
def test_a_signal_ends_the_wait_for_a_reader(pipe: FullPipe) -> None:
    """Whoever presses Ctrl-C after Ctrl-S gets the prompt back; nothing keeps a lock that the end of Python needs."""
    pipe.connect()
    timer = threading.Timer(0.3, os.kill, [os.getpid(), signal.SIGINT])
    timer.start()
    with pytest.raises(KeyboardInterrupt), queue_output():
        notify("never read")
    timer.join()
    assert sys.stderr is pipe.stream
    pipe.stream.flush()
    os.set_blocking(pipe.out, False)
    with suppress(BlockingIOError):
        while True:
            os.read(pipe.out, 65536)


def test_streams_without_a_descriptor_get_the_same_text(monkeypatch: pytest.MonkeyPatch) -> None:
    out, errors = io.StringIO(), io.StringIO()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", errors)
    with queue_output(), queue_output():
        echo("result")
        notify("note")
        stream = sys.stderr
    print("late", file=stream)  # a handler of a log that was made within
    assert (out.getvalue(), errors.getvalue()) == ("result\n", "note\nlate\n")
