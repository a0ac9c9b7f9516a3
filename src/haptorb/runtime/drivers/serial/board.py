"""The firmware behind a serial port, one question and one answer at a time."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic, sleep
from typing import final

import numpy as np

from haptorb.errors import DriverError
from haptorb.numerics.arrays import Records
from haptorb.runtime.drivers.electronics import counts
from haptorb.runtime.drivers.serial.codes import BoardMode, Refusal
from haptorb.runtime.drivers.serial.frames import Frame, FrameParser, Numbers, encode
from haptorb.runtime.drivers.serial.messages import refusal
from haptorb.runtime.drivers.serial.protocol import READING, SET_BYTES, STATE, Command, engage, set_line
from haptorb.runtime.drivers.serial.reading import Reading, Reply, find_answer, make_reading
from haptorb.runtime.drivers.serial.replies import BoardLimits, BoardState, Identity
from haptorb.runtime.drivers.serial.serial_port import SerialPort

__all__ = ["Board"]

_ANSWER = 0.05  #: a line that is alive answers within a millisecond [s]
_AGAIN = 0.25  #: between two questions to a board that may be starting [s]
_TRIES = 3
_EEPROM = 30.0  #: twenty-one bytes take 72 ms; an emulated processor may be slow [s]
_ASK_AGAIN = 0.005  #: whether it is written [s]


@final
class Board:
    """Questions and answers; `post` and `collect` split the one that is asked every millisecond.

    Opening waits until the firmware has answered (an Arduino restarts when its port is opened, which takes up to two
    seconds), at most `patience` [s], and leaves the coils off. `answer` [s] is how long any later answer may take;
    `clock` gives the time of a request, for `asked`.

    Raises DriverError if the port cannot be opened, if nothing answers there, or if what answers is not haptorb's
    firmware with this version's protocol.
    """

    def __init__(
        self, path: str, patience: float = 3.0, answer: float = _ANSWER, clock: Callable[[], float] = monotonic
    ) -> None:
        self._answer = answer
        self._clock = clock
        self._parser = FrameParser()
        self._sequence = 0
        self._waiting: int | None = None  #: sequence of the SET or READ whose answer has not been collected
        self._first = 0  #: sequence of the first that asked the same
        self.asked = 0.0  #: when the question was sent whose answer was collected last [s]
        # Used again every millisecond; and everything compiled before a port is opened, as the firmware does not wait.
        self._asked_at = [0.0] * 256  # [s], by sequence
        self._out, self._at = np.zeros(SET_BYTES, np.uint8), np.zeros(1, np.int64)
        self._payload = self._out.data
        self._reading = make_reading()
        set_line(self._out, 0, np.array(counts(np.zeros(3)), np.int64))
        find_answer(self._parser.line, self._parser.held, 0, 0, self._reading, self._at)
        self._port = SerialPort(path)
        try:
            self.identity = self._identify(patience)
            self.limits = BoardLimits.parse(self._ask(Command.LIMITS, b"", 0x80 | Command.LIMITS).payload)
            self.switch_off()
        except BaseException:
            self._port.close()
            raise

    @property
    def path(self) -> str:
        """The port."""
        return self._port.path

    @property
    def bad_frames(self) -> int:
        """Frames from the firmware whose check sum was wrong."""
        return self._parser.bad_frames

    def _identify(self, patience: float) -> Identity:
        end = monotonic() + patience
        received = 0
        while True:
            self._send(Frame(Command.IDENTIFY, self._next(), b""))
            frame, count = self._await_frame(
                0x80 | Command.IDENTIFY, self._sequence, min(max(0.1, self._answer), _AGAIN)
            )
            received += count
            if frame is not None:
                identity = Identity.parse(frame.payload)
                if identity.name != "haptorb":
                    raise DriverError(
                        f"the device at {self.path} identifies itself as '{identity.name}', not 'haptorb'; choose "
                        "another port"
                    )
                return identity
            if monotonic() > end:
                if received:
                    raise DriverError(
                        f"something responds at {self.path}, but it is not haptorb's firmware (or not at 1 Mbaud); "
                        "choose another port or flash the firmware (`make firmware`)"
                    )
                raise DriverError(f"nothing responds at {self.path}; is the device powered, and is this its port?")

    def _next(self) -> int:
        self._sequence = (self._sequence + 1) & 0xFF
        return self._sequence

    def _send(self, frame: Frame) -> None:
        self._port.send(encode(frame))

    def _await_frame(self, kind: int, sequence: int, patience: float) -> tuple[Frame | None, int]:
        """The frame of this kind and number, or None; and how many bytes came."""
        end = monotonic() + patience
        count = 0
        while True:
            count += self._receive(end)
            while (frame := self._parser.next()) is not None:
                if frame.sequence == sequence and frame.type == kind:
                    return frame, count
                if frame.sequence == sequence and frame.type == STATE:
                    raise _refusal_error(kind, frame)
            if monotonic() >= end:
                return None, count

    def _receive(self, end: float) -> int:
        """How many bytes came, waiting until `end` [s] at the latest."""
        count = self._port.receive(self._parser.free_space, end - monotonic())
        self._parser.commit(count)
        return count

    def _ask(self, command: Command, payload: bytes, kind: int) -> Frame:
        for _ in range(_TRIES):
            sequence = self._next()
            self._send(Frame(command, sequence, payload))
            frame, _ = self._await_frame(kind, sequence, self._answer)
            if frame is not None:
                return frame
        raise DriverError(f"the firmware at {self.path} does not respond; check the cable and the device's supply")

    def _state(self, make: Callable[[int], Frame]) -> BoardState:
        for _ in range(_TRIES):
            sequence = self._next()
            self._send(make(sequence))
            frame, _ = self._await_frame(STATE, sequence, self._answer)
            if frame is not None:
                return BoardState.parse(frame.payload)
        raise DriverError(f"the firmware at {self.path} does not respond; check the cable and the device's supply")

    def engage(self, duty_limit: float = 1.0, current_limit: float = 65.5) -> BoardState:
        """Let the coils have current, within these limits; `refusal` holds the reason if it was refused."""
        return self._state(lambda sequence: engage(sequence, duty_limit, current_limit))

    def switch_off(self) -> BoardState:
        """Coils off; a trip is forgotten."""
        return self._state(lambda sequence: Frame(Command.OFF, sequence, b""))

    def store(self, calibration: bytes) -> BoardState:
        """Wish for the 16-byte id of the calibration that belongs to this device to be kept; see `keep`.

        Accepted once it has been written and read back, refused as WRITING until then: ask again.
        """
        return self._state(lambda sequence: Frame(Command.STORE, sequence, calibration))

    def keep(self, calibration: bytes) -> None:
        """Keep that id: returns when the EEPROM has it, and a reset can lose it no more.

        Raises DriverError if the firmware refuses it (coils engaged), or if its EEPROM does not keep it.
        """
        end = monotonic() + _EEPROM
        # safety: eeprom-kept
        while (state := self.store(calibration)).refusal is Refusal.WRITING and monotonic() < end:
            sleep(_ASK_AGAIN)
        why = refusal(state)
        if not why and self.identify().calibration != calibration:
            why = "it stores another id"
        if why:
            raise DriverError(f"the firmware did not store the calibration's id: {why}")

    def identify(self) -> Identity:
        """Who answers, asked once more: what was stored shows here."""
        self.identity = Identity.parse(self._ask(Command.IDENTIFY, b"", 0x80 | Command.IDENTIFY).payload)
        return self.identity

    def read(self) -> Reading:
        """One reading, and nothing else."""
        return Reading.of(self.read_numbers())

    def read_numbers(self) -> Records:
        """The same as (1,) BOARD_READING; the next is written over it."""
        for _ in range(_TRIES):
            self.post(None)
            reading = self.collect(self._answer)
            if reading is not None:
                return reading
        raise DriverError(f"the firmware at {self.path} does not respond; check the cable and the device's supply")

    def set(self, steps: list[int]) -> Reading:
        """New duties in signed steps, and one reading. Raises DriverError if the firmware refuses them or is silent."""
        self.post(np.array(steps, np.int64))
        reading = self.collect(self._answer)
        if reading is None:
            raise DriverError(f"the firmware at {self.path} does not respond; check the cable and the device's supply")
        return Reading.of(reading)

    def post(self, steps: Numbers | None) -> None:
        """Send new duties (3,) in signed steps, or without them only ask for a reading; it is collected later."""
        self._first = (self._sequence + 1) & 0xFF
        self.repeat(steps)

    def repeat(self, steps: Numbers | None) -> None:
        """Ask the same as the last `post` again, with a number of its own; any of up to 255 answers will do."""
        sequence = self._next()
        self._waiting = sequence
        self._asked_at[sequence] = self._clock()
        if steps is None:
            self._send(Frame(Command.READ, sequence, b""))
            return
        set_line(self._out, sequence, steps)
        self._port.send(self._payload)

    @property
    def is_posted(self) -> bool:
        """A question waits for its answer to be collected."""
        return self._waiting is not None

    def collect(self, patience: float) -> Records | None:
        """The answer to `post`, (1,) BOARD_READING, waiting at most `patience` [s]; None if it did not come.
        The next one is written over it.

        Raises DriverError if the firmware refuses what was posted, or if what it answers is no reading.
        """
        if self._waiting is None:
            return None
        last, self._waiting = self._waiting, None
        parser, end = self._parser, monotonic() + patience
        while True:
            self._receive(end)
            answer = find_answer(parser.line, parser.held, self._first, last, self._reading, self._at)
            if answer == Reply.READING:
                self.asked = self._asked_at[parser.line[self._at[0] + 4]]
                return self._reading
            if answer == Reply.OTHER:
                raise _refusal_error(READING, parser.frame(int(self._at[0])))
            if answer == Reply.BENT:
                Reading.parse(parser.frame(int(self._at[0])).payload)  # says what is wrong with it
            if monotonic() >= end:
                return None

    def close(self) -> bool:
        """Coils off if the line still works, then the port; whether the firmware said that they are. May be called
        twice."""
        try:
            self._send(Frame(Command.OFF, self._next(), b""))
            frame, _ = self._await_frame(STATE, self._sequence, self._answer)
            return frame is not None and BoardState.parse(frame.payload).mode is not BoardMode.ENGAGED
        except DriverError:
            return False  # the line is lost: the firmware's own watchdog has switched off
        finally:
            self._port.close()


def _refusal_error(kind: int, frame: Frame) -> DriverError:
    state = BoardState.parse(frame.payload)
    return DriverError(f"the firmware did not accept the command {kind & 0x7F}: {state.refusal.name}")
