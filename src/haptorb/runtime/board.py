"""The firmware behind a serial port, one question and one answer at a time."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic
from typing import final

from haptorb.errors import DriverError
from haptorb.runtime.board_answers import BoardLimits, BoardState, Identity
from haptorb.runtime.board_reading import Reading
from haptorb.runtime.frames import Frame, FrameParser, encoded
from haptorb.runtime.protocol import READING, STATE, Command, engage, set_duties
from haptorb.runtime.serial_port import SerialPort

__all__ = ["Board"]

_ANSWER = 0.05  #: a line that is alive answers within a millisecond [s]
_TRIES = 3


@final
class Board:
    """Questions and answers; `post` and `collect` split the one that is asked every millisecond.

    Opening waits until the firmware has answered (an Arduino restarts when its port is opened, which takes up to two
    seconds), at most `patience` [s], and leaves the coils off. `answer` [s] is how long any later answer may take.

    Raises DriverError if the port cannot be opened, if nothing answers there, or if what answers is not haptorb's
    firmware with this version's protocol.
    """

    def __init__(self, path: str, patience: float = 3.0, answer: float = _ANSWER) -> None:
        self._port = SerialPort(path)
        self._answer = answer
        self._parser = FrameParser()
        self._sequence = 0
        self._waiting: int | None = None  #: sequence of the SET or READ whose answer has not been collected
        try:
            self.identity = self._met(patience)
            self.limits = BoardLimits.parse(self._asked(Command.LIMITS, b"", 0x80 | Command.LIMITS).payload)
            self.off()
        except BaseException:
            self._port.close()
            raise

    @property
    def path(self) -> str:
        """The port."""
        return self._port.path

    @property
    def damaged(self) -> int:
        """Frames from the firmware whose check sum was wrong."""
        return self._parser.damaged

    def _met(self, patience: float) -> Identity:
        end = monotonic() + patience
        heard = 0
        while True:
            self._send(Frame(Command.IDENTIFY, self._next(), b""))
            frame, count = self._awaited(0x80 | Command.IDENTIFY, self._sequence, max(0.1, self._answer))
            heard += count
            if frame is not None:
                identity = Identity.parse(frame.payload)
                if identity.name != "haptorb":
                    raise DriverError(f"the device at {self.path} calls itself '{identity.name}', not 'haptorb'")
                return identity
            if monotonic() > end:
                if heard:
                    raise DriverError(
                        f"something answers at {self.path}, but it is not haptorb's firmware (or not at 1 Mbaud); "
                        "choose another port or flash the firmware (`make firmware`)"
                    )
                raise DriverError(f"nothing answers at {self.path}; is the device powered, and is this its port?")

    def _next(self) -> int:
        self._sequence = (self._sequence + 1) & 0xFF
        return self._sequence

    def _send(self, frame: Frame) -> None:
        self._port.send(encoded(frame))

    def _awaited(self, kind: int, sequence: int, patience: float) -> tuple[Frame | None, int]:
        """The frame of this kind and number, or None; and how many bytes came."""
        end = monotonic() + patience
        heard = 0
        while True:
            data = self._port.receive(end - monotonic())
            heard += len(data)
            for frame in self._parser.feed(data):
                if frame.sequence == sequence and frame.type == kind:
                    return frame, heard
                if frame.sequence == sequence and frame.type == STATE:
                    state = BoardState.parse(frame.payload)
                    raise DriverError(f"the firmware did not take the command {kind & 0x7F}: {state.refusal.name}")
            if monotonic() >= end:
                return None, heard

    def _asked(self, command: Command, payload: bytes, kind: int) -> Frame:
        for _ in range(_TRIES):
            sequence = self._next()
            self._send(Frame(command, sequence, payload))
            frame, _ = self._awaited(kind, sequence, self._answer)
            if frame is not None:
                return frame
        raise DriverError(f"the firmware at {self.path} does not answer; check the cable and the device's supply")

    def _state(self, make: Callable[[int], Frame]) -> BoardState:
        for _ in range(_TRIES):
            sequence = self._next()
            self._send(make(sequence))
            frame, _ = self._awaited(STATE, sequence, self._answer)
            if frame is not None:
                return BoardState.parse(frame.payload)
        raise DriverError(f"the firmware at {self.path} does not answer; check the cable and the device's supply")

    def engage(self, duty_limit: float = 1.0, current_limit: float = 65.5) -> BoardState:
        """Let the coils have current, within these limits; `refusal` tells if it was refused."""
        return self._state(lambda sequence: engage(sequence, duty_limit, current_limit))

    def off(self) -> BoardState:
        """Coils off; a trip is forgotten."""
        return self._state(lambda sequence: Frame(Command.OFF, sequence, b""))

    def store(self, calibration: bytes) -> BoardState:
        """Write the 16-byte id of the calibration that belongs to this device; refused while the coils are engaged."""
        return self._state(lambda sequence: Frame(Command.STORE, sequence, calibration))

    def identify(self) -> Identity:
        """Who answers, asked once more: what was stored shows here."""
        self.identity = Identity.parse(self._asked(Command.IDENTIFY, b"", 0x80 | Command.IDENTIFY).payload)
        return self.identity

    def read(self) -> Reading:
        """One reading, and nothing else."""
        return Reading.parse(self._asked(Command.READ, b"", READING).payload)

    def set(self, steps: list[int]) -> Reading:
        """New duties in signed steps, and one reading. Raises DriverError if the firmware refuses them or is silent."""
        self.post(steps)
        reading = self.collect(self._answer)
        if reading is None:
            raise DriverError(f"the firmware at {self.path} does not answer; check the cable and the device's supply")
        return reading

    def post(self, steps: list[int] | None) -> None:
        """Send new duties, or without them only ask for a reading; the answer is collected later."""
        sequence = self._next()
        self._waiting = sequence
        self._send(Frame(Command.READ, sequence, b"") if steps is None else set_duties(sequence, steps))

    @property
    def posted(self) -> bool:
        """A question waits for its answer to be collected."""
        return self._waiting is not None

    def collect(self, patience: float) -> Reading | None:
        """The answer to `post`, waiting at most `patience` [s]; None if it did not come."""
        if self._waiting is None:
            return None
        sequence, self._waiting = self._waiting, None
        frame, _ = self._awaited(READING, sequence, patience)
        return None if frame is None else Reading.parse(frame.payload)

    def close(self) -> None:
        """Coils off if the line still works, then the port. May be called twice."""
        try:
            self._send(Frame(Command.OFF, self._next(), b""))
            self._awaited(STATE, self._sequence, self._answer)
        except DriverError:
            pass  # the line is dead: the firmware's own watchdog has switched off
        finally:
            self._port.close()
