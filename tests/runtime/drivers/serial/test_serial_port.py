"""Detection of the board at a port: every mistake in one sentence with its remedy."""

from __future__ import annotations

import errno
import os
import pty
import struct
import threading
from collections.abc import Callable, Iterator

import pytest

from haptorb.errors import DriverError
from haptorb.runtime.drivers import serial
from haptorb.runtime.drivers.serial import Board
from haptorb.runtime.drivers.serial_protocol import PROTOCOL_VERSION, Command, Frame, FrameParser, encode

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize(
    ("number", "told"),
    [
        (errno.EACCES, r"no permission .* usermod -aG dialout"),
        (errno.EPERM, r"usermod -aG dialout"),
        (errno.EBUSY, r"in use by another program"),
        (errno.ENOENT, r"there is no port .* plugged in now"),
        (errno.EIO, r"cannot open"),
    ],
)
def test_a_port_that_cannot_be_opened_is_explained(number: int, told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*arguments: object, **named: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(serial, "_serial", lambda: refuse)
    monkeypatch.setattr(serial, "port_list", lambda: [("/dev/ttyACM7", "Arduino")])
    with pytest.raises(DriverError, match=told):
        serial.SerialPort("/dev/ttyACM0")


@pytest.fixture
def answering() -> Iterator[Callable[[Callable[[bytes], bytes]], str]]:
    """A pseudo-terminal with a device behind it that answers as the test wants; gives its path."""
    running: list[tuple[int, int, threading.Event, threading.Thread]] = []

    def start(answer: Callable[[bytes], bytes]) -> str:
        device, host = pty.openpty()
        over = threading.Event()

        def serve() -> None:
            while not over.is_set():
                try:
                    said = answer(os.read(device, 256))
                    if said:
                        os.write(device, said)
                except OSError:
                    return

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        running.append((device, host, over, thread))
        return os.ttyname(host)

    yield start
    for device, host, over, thread in running:
        over.set()
        os.write(host, b"\0")  # wakes the reader
        thread.join(5.0)
        os.close(host)
        os.close(device)


def identity(protocol: int = PROTOCOL_VERSION, name: bytes = b"haptorb") -> Callable[[bytes], bytes]:
    """A device that says who it is."""
    parser = FrameParser()

    def answer(data: bytes) -> bytes:
        said = b""
        for frame in parser.feed(data):
            if frame.type == Command.IDENTIFY:
                payload = struct.pack("<9B8s16s", protocol, 1, 0, 1, 3, 9, 3, 3, 16, name, bytes(16))
                said += encode(Frame(0x80 | Command.IDENTIFY, frame.sequence, payload))
        return said

    return answer


def test_another_program_at_the_other_end_is_told(answering: Callable[..., str]) -> None:
    port = answering(lambda data: b"AT OK\r\n")
    with pytest.raises(DriverError, match=r"not haptorb's firmware .*another port or flash"):
        Board(port, timeout=0.3)


def test_silence_is_told(answering: Callable[..., str]) -> None:
    port = answering(lambda data: b"")
    with pytest.raises(DriverError, match=r"nothing responds .* powered"):
        Board(port, timeout=0.3)


def test_a_firmware_of_another_version_is_told_with_both(answering: Callable[..., str]) -> None:
    port = answering(identity(protocol=PROTOCOL_VERSION + 1))
    with pytest.raises(DriverError, match=rf"version {PROTOCOL_VERSION + 1}.* version {PROTOCOL_VERSION}.*flash"):
        Board(port, timeout=0.3)


def test_a_device_of_another_name_is_told(answering: Callable[..., str]) -> None:
    port = answering(identity(name=b"toaster"))
    with pytest.raises(DriverError, match="identifies itself as 'toaster'"):
        Board(port, timeout=0.3)


def test_a_device_that_falls_silent_in_the_middle_is_told(answering: Callable[..., str]) -> None:
    port = answering(identity())  # says who it is, and nothing else
    with pytest.raises(DriverError, match="does not respond; check the cable"):
        Board(port, timeout=0.3)
