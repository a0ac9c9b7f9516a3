"""Board on a pseudo-terminal, in a thread, that answers like the firmware: for tests without an emulator."""

from __future__ import annotations

import os
import pty
import struct
import threading
import tty

from haptorb.runtime.drivers.serial_protocol import (
    PROTOCOL_VERSION,
    READING,
    STATE,
    BoardMode,
    Command,
    Frame,
    FrameParser,
    Reason,
    Refusal,
    encode,
)


class PretendBoard:
    """Says what its attributes say; `path` is its port."""

    def __init__(self, hall_axes: int = 3) -> None:
        self.hall_axes, self.missing, self.mute = hall_axes, 0, False
        self.mode, self.reason, self.refusal = BoardMode.OFF, Reason.NONE, Refusal.ACCEPTED
        self.payload: bytes | None = None  #: instead of a reading's
        self.calibration, self.writing = bytes(16), 0  #: what is kept; how often it says that it is still writing
        self.late = 0.0  #: [s] from a question to its answer
        self.duties = [0, 0, 0]
        self.heard: list[Frame] = []
        self._group, self._thermometer = 0, 0
        self._on_the_way: list[threading.Timer] = []
        self._device, self._host = pty.openpty()
        tty.setraw(self._device)
        tty.setraw(self._host)
        self.path = os.ttyname(self._host)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        parser = FrameParser()
        while not self._over.is_set():
            for frame in parser.feed(os.read(self._device, 256)):
                self.heard.append(frame)
                if not self.mute:
                    self._say(encode(self._answer(frame)))

    def _say(self, line: bytes) -> None:
        if self.late:
            self._on_the_way.append(threading.Timer(self.late, os.write, (self._device, line)))
            self._on_the_way[-1].start()
        else:
            os.write(self._device, line)

    def _answer(self, frame: Frame) -> Frame:
        if frame.type == Command.IDENTIFY:
            who = struct.pack(
                "<9B8s16s", PROTOCOL_VERSION, 1, 0, 1, 3, 9, self.hall_axes, 3, 16, b"haptorb", self.calibration
            )
            return Frame(0x80 | Command.IDENTIFY, frame.sequence, who)
        if frame.type == Command.LIMITS:
            limits = struct.pack("<7Hh2H", 4095, 21000, 4095, 21000, 15, 5300, 4300, 1360, 4095, 1000)
            return Frame(0x80 | Command.LIMITS, frame.sequence, limits)
        if frame.type in (Command.SET, Command.READ):
            if frame.type == Command.SET and self.mode == BoardMode.ENGAGED:
                self.duties = list(struct.unpack("<3h", frame.payload))
            return Frame(READING, frame.sequence, self._reading() if self.payload is None else self.payload)
        if frame.type == Command.ENGAGE and self.refusal is Refusal.ACCEPTED:
            self.mode = BoardMode.ENGAGED
        if frame.type == Command.OFF:
            self.mode, self.duties = BoardMode.OFF, [0, 0, 0]
        refusal = self.refusal if frame.type in (Command.ENGAGE, Command.STORE) else Refusal.ACCEPTED
        if frame.type == Command.STORE and refusal is Refusal.ACCEPTED:
            if self.writing:
                self.writing, refusal = self.writing - 1, Refusal.WRITING
            else:
                self.calibration = frame.payload
        state = struct.pack("<BBHB", self.mode, self.reason, self.missing, refusal)
        return Frame(STATE, frame.sequence, state)

    def _reading(self) -> bytes:
        self._group = (self._group + 1) % (2 * self.hall_axes)
        self._thermometer = (self._thermometer + 1) % 3
        codes = [2048 + 100 * self._group + k for k in range(5)]
        currents = [5 * duty for duty in self.duties]  # 20 A at full duty
        return struct.pack(
            "<BBH3h3hB5HBhHHBB", self.mode, self.reason, self.missing, *self.duties, *currents, self._group, *codes,
            self._thermometer, 400 + 16 * self._thermometer, 868, 420, 0, 0,
        )  # fmt: skip

    def close(self) -> None:
        """Ends the threads; an answer on its way is lost, and not written to what is another file by then."""
        self._over.set()
        os.write(self._host, b"\0")  # wakes the reader
        self._thread.join(5.0)
        for answer in self._on_the_way:
            answer.cancel()
            answer.join(5.0)
        os.close(self._host)
        os.close(self._device)
