"""Driver of a real device on a serial port: one frame each way per tick; no current until the coils are engaged."""

from __future__ import annotations

import errno
import os
import select
from collections.abc import Callable
from contextlib import suppress
from time import monotonic, sleep
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Array, Records
from haptorb.compiled import kernel, load_compiler
from haptorb.control.trip_reasons import CoilState
from haptorb.devices.base import Device
from haptorb.errors import DriverError, HostSilent, InputError
from haptorb.estimation.types import Pose, Sample
from haptorb.runtime.drivers.base import (
    CHANNELS,
    DUTY_STEPS,
    Driver,
    HallSensors,
    check_electronics,
    counts,
    fill_field,
    invalid_pose,
    quantise_duties,
)
from haptorb.runtime.drivers.serial_protocol import (
    BLOCKS,
    READING,
    SET_BYTES,
    STATE,
    BoardLimits,
    BoardMode,
    BoardState,
    Command,
    Frame,
    FrameParser,
    Identity,
    Numbers,
    Reading,
    Reason,
    Refusal,
    Reply,
    encode,
    engage,
    explain_off,
    find_answer,
    make_reading,
    missing_chips,
    refusal,
    set_line,
)

__all__ = ["BAUD", "Board", "BoardSample", "BoardTime", "SerialDriver", "SerialPort", "port_list"]


# --------------------------------------------------------------------------------------------------
# A serial port at 1 Mbaud, opened exclusively; failures to open it are explained.


BAUD = 1_000_000


def _serial() -> Any:
    try:
        from serial import Serial
    except ImportError as cause:
        raise DriverError(
            "serial ports need the package pyserial; install it with `pip install 'haptorb[hardware]'`"
        ) from cause
    return Serial


def port_list() -> list[tuple[str, str]]:
    """Serial ports of this computer, (path, description) each, probable Arduinos first."""
    _serial()
    from serial.tools.list_ports import comports

    found = [(port.device, port.description or "", port.vid is not None) for port in comports()]
    return [(path, about) for path, about, usb in sorted(found, key=lambda one: (not one[2], one[0])) if usb]


def _explain_port_error(path: str, cause: OSError) -> DriverError:
    number = cause.errno
    text = str(cause)
    if number in (errno.EACCES, errno.EPERM):
        return DriverError(
            f"no permission to open {path}: join its group with `sudo usermod -aG dialout $USER`, "
            "then log out and in again"
        )
    if number == errno.ENOENT:
        with suppress(DriverError):
            ports = ", ".join(one for one, _ in port_list())
            return DriverError(f"there is no port {path}; plugged in now: {ports or 'none'}")
    if number == errno.EBUSY or "exclusively lock" in text:
        return DriverError(f"{path} is in use by another program; close that one first")
    return DriverError(f"cannot open {path}: {text}")


@final
class SerialPort:
    """Serial port with a read timeout. A failure of the line closes the port and raises DriverError."""

    def __init__(self, path: str) -> None:
        serial = _serial()
        self.path = path
        try:
            self._port = serial(path, BAUD, timeout=0, write_timeout=0, exclusive=True)
        except OSError as cause:  # base class of pyserial's own error
            raise _explain_port_error(path, cause) from cause
        except ValueError as cause:
            raise DriverError(f"{path} is not a serial port for {BAUD} baud: {cause}") from cause
        with suppress(OSError, ValueError, NotImplementedError, AttributeError):
            self._port.set_low_latency_mode(True)  # USB adapters delay bytes by 16 ms otherwise
        self._number = self._port.fileno()

    def close(self) -> None:
        """May be called twice."""
        with suppress(OSError):
            self._port.close()

    def _lose_port(self, cause: Exception | None) -> DriverError:
        self.close()
        why = f": {cause}" if cause else ""
        return DriverError(f"{self.path} has disappeared{why}; check the cable")

    def send(self, data: bytes | memoryview) -> None:
        """Send all of `data`; a partial write is an error, because a partial frame is useless."""
        try:
            if os.write(self._number, data) != len(data):
                raise self._lose_port(None)
        except (OSError, ValueError) as cause:
            raise self._lose_port(cause) from cause

    def receive(self, room: memoryview, timeout: float) -> int:
        """Receive bytes into `room`, waiting at most `timeout` [s]; return their number, 0 if none came."""
        try:
            count = os.readv(self._number, (room,))  # usually the answer has arrived: no need to poll first
            if count:
                return count
        except BlockingIOError:
            pass
        except (OSError, ValueError) as cause:
            raise self._lose_port(cause) from cause
        try:
            ready, _, _ = select.select((self._number,), (), (), max(timeout, 0.0))
            if not ready:
                return 0
            count = os.readv(self._number, (room,))
        except BlockingIOError:
            return 0
        except (OSError, ValueError) as cause:
            raise self._lose_port(cause) from cause
        if not count:  # readable and empty: the other end was closed
            raise self._lose_port(None)
        return count


# --------------------------------------------------------------------------------------------------
# Client of the firmware on a serial port: one request and one response at a time.


_RESPONSE_S = 0.05  #: response timeout; a working line answers within 1 ms
_START_RETRY_INTERVAL_S = 0.25  #: between two requests to a board that may be starting
_TRIES = 3
_EEPROM_TIMEOUT_S = 30.0  #: of writing the EEPROM: twenty-one bytes take 72 ms; an emulated processor may be slow
_WRITE_CHECK_INTERVAL_S = 0.005  #: between two checks whether it is written


@final
class Board:
    """Requests and responses; `post` and `collect` split the periodic one.

    Opening waits until the firmware has answered (an Arduino restarts when its port is opened, which takes up to 2 s),
    at most `timeout` [s], and leaves the coils off. `answer` [s] is the timeout of any later response;
    `clock` returns the time of a request, for `asked`.

    Raises DriverError if the port cannot be opened, if there is no response, or if it is not that of haptorb's firmware
    with this version's protocol.
    """

    def __init__(
        self, path: str, timeout: float = 3.0, answer: float = _RESPONSE_S, clock: Callable[[], float] = monotonic
    ) -> None:
        self._answer = answer
        self._clock = clock
        self._parser = FrameParser()
        self._sequence = 0
        self._waiting: int | None = None  #: sequence number of the SET or READ whose response is pending
        self._first = 0  #: sequence number of the first of its repetitions
        self.asked = 0.0  #: time of the request whose response was collected last [s]
        # Reused every millisecond; all code is compiled before a port is opened, as the firmware does not wait.
        self._asked_at = [0.0] * 256  # time of the request by sequence number [s]
        self._out, self._at = np.zeros(SET_BYTES, np.uint8), np.zeros(1, np.int64)
        self._payload = self._out.data
        self._reading = make_reading()
        set_line(self._out, 0, np.array(counts(np.zeros(3)), np.int64))
        find_answer(self._parser.line, self._parser.held, 0, 0, self._reading, self._at)
        self._port = SerialPort(path)
        try:
            self.identity = self._identify(timeout)
            self.limits = BoardLimits.parse(self._ask(Command.LIMITS, b"", 0x80 | Command.LIMITS).payload)
            self.switch_off()
        except BaseException:
            self._port.close()
            raise

    @property
    def path(self) -> str:
        """Path of the port."""
        return self._port.path

    @property
    def bad_frames(self) -> int:
        """Number of frames from the firmware with a wrong checksum."""
        return self._parser.bad_frames

    def _identify(self, timeout: float) -> Identity:
        end = monotonic() + timeout
        received = 0
        while True:
            self._send(Frame(Command.IDENTIFY, self._next(), b""))
            frame, count = self._await_frame(
                0x80 | Command.IDENTIFY, self._sequence, min(max(0.1, self._answer), _START_RETRY_INTERVAL_S)
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

    def _await_frame(self, kind: int, sequence: int, timeout: float) -> tuple[Frame | None, int]:
        """Wait for the frame of this kind and sequence number; return it, or None, and the number of bytes received."""
        end = monotonic() + timeout
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
        """Receive bytes, waiting until `end` [s] at the latest; return their number."""
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
        """Enable the coils within these limits; `refusal` states the reason if that was refused."""
        return self._state(lambda sequence: engage(sequence, duty_limit, current_limit))

    def switch_off(self) -> BoardState:
        """Switch the coils off; clears a trip."""
        return self._state(lambda sequence: Frame(Command.OFF, sequence, b""))

    def store(self, calibration: bytes) -> BoardState:
        """Request to store the 16-byte id of this device's calibration, without waiting; see `store_and_wait`.

        Accepted once it has been written and read back, refused as WRITING until then: repeat the request.
        """
        return self._state(lambda sequence: Frame(Command.STORE, sequence, calibration))

    def store_and_wait(self, calibration: bytes) -> None:
        """Store that id; returns when the EEPROM contains it, so that a reset cannot lose it.

        Raises DriverError if the firmware refuses it (coils engaged), or if its EEPROM does not retain it.
        """
        end = monotonic() + _EEPROM_TIMEOUT_S
        # safety: eeprom-kept
        while (state := self.store(calibration)).refusal is Refusal.WRITING and monotonic() < end:
            sleep(_WRITE_CHECK_INTERVAL_S)
        why = refusal(state)
        if not why and self.identify().calibration != calibration:
            why = "it stores another id"
        if why:
            raise DriverError(f"the firmware did not store the calibration's id: {why}")

    def identify(self) -> Identity:
        """Read the identity again, with the stored id."""
        self.identity = Identity.parse(self._ask(Command.IDENTIFY, b"", 0x80 | Command.IDENTIFY).payload)
        return self.identity

    def read(self) -> Reading:
        """Request one reading."""
        return Reading.of(self.read_numbers())

    def read_numbers(self) -> Records:
        """The same as (1,) BOARD_READING; overwritten by the next."""
        for _ in range(_TRIES):
            self.post(None)
            reading = self.collect(self._answer)
            if reading is not None:
                return reading
        raise DriverError(f"the firmware at {self.path} does not respond; check the cable and the device's supply")

    def set(self, steps: list[int]) -> Reading:
        """Set duties in signed steps, and return a reading. DriverError if the firmware refuses them or is silent."""
        self.post(np.array(steps, np.int64))
        reading = self.collect(self._answer)
        if reading is None:
            raise DriverError(f"the firmware at {self.path} does not respond; check the cable and the device's supply")
        return Reading.of(reading)

    def post(self, steps: Numbers | None) -> None:
        """Send new duties (3,) in signed steps, or None to only request a reading; it is collected later."""
        self._first = (self._sequence + 1) & 0xFF
        self.repeat(steps)

    def repeat(self, steps: Numbers | None) -> None:
        """Repeat the last `post` with a new sequence number; the response to any of up to 255 requests is accepted."""
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
        """Whether a response is pending."""
        return self._waiting is not None

    def collect(self, timeout: float) -> Records | None:
        """Collect the response to `post`, (1,) BOARD_READING, waiting at most `timeout` [s]; None if it did not come.
        The next one overwrites it.

        Raises DriverError if the firmware refuses the request, or if its response is not a reading.
        """
        if self._waiting is None:
            return None
        last, self._waiting = self._waiting, None
        parser, end = self._parser, monotonic() + timeout
        while True:
            self._receive(end)
            answer = find_answer(parser.line, parser.held, self._first, last, self._reading, self._at)
            if answer == Reply.READING:
                self.asked = self._asked_at[parser.line[self._at[0] + 4]]
                return self._reading
            if answer == Reply.OTHER:
                raise _refusal_error(READING, parser.frame(int(self._at[0])))
            if answer == Reply.BENT:
                Reading.parse(parser.frame(int(self._at[0])).payload)  # raises with the reason
            if monotonic() >= end:
                return None

    def close(self) -> bool:
        """Switch the coils off if the line still works, then close the port; return whether the firmware confirmed off.
        May be called twice."""
        try:
            self._send(Frame(Command.OFF, self._next(), b""))
            frame, _ = self._await_frame(STATE, self._sequence, self._answer)
            return frame is not None and BoardState.parse(frame.payload).mode is not BoardMode.ENGAGED
        except DriverError:
            return False  # the line is lost: the firmware's own watchdog switches off
        finally:
            self._port.close()


def _refusal_error(kind: int, frame: Frame) -> DriverError:
    state = BoardState.parse(frame.payload)
    return DriverError(f"the firmware did not accept the command {kind & 0x7F}: {state.refusal.name}")


# --------------------------------------------------------------------------------------------------
# Time of a board's response on the clock of the loop.


#: From sending a request to composing its response [s]: 13 bytes at 1 Mbaud, and their check. The delay of a USB bridge
#: is the same for all values in one response; their relative ages are by the board's own clock.
_LINE_DELAY = 0.25e-3


@final
class BoardTime:
    """Times of the last two ticks, on the loop's clock and on the `clock` of requests [s].

    A response is as old as its request, and not as the tick in which it is read: if a tick is late, the response was
    waiting in the buffer.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._before = self._here = (0.0, 0.0)

    def tick(self, now: float) -> None:
        """Record the begin of the tick at `now` [s]."""
        self._before, self._here = self._here, (now, self._clock())

    def time_of_answer(self, asked: float) -> float:
        """Time of the response to the request at `asked` [s, `clock`] on the loop's clock [s].

        >>> time = iter([10.0, 11.5])
        >>> board = BoardTime(lambda: next(time))
        >>> board.tick(0.0)
        >>> board.tick(1.0)                         # half a second late
        >>> round(board.time_of_answer(10.25), 5)         # requested 0.25 s after the first began
        0.25025
        """
        at, start = self._here if asked >= self._here[1] else self._before
        return at + (asked - start) + _LINE_DELAY


# --------------------------------------------------------------------------------------------------
# Assembly of samples: every response contains a part of the readings.


#: A current sensor converts for 0.53 ms and reports the last whole conversion, whose middle was 0.53 ms ago on average;
#: the three are read one after the other in 0.2 ms, and the firmware reports the age of the first [s].
_CONVERTED = 0.43e-3
#: The firmware reports when it read the last of four or five Hall sensors; they take 0.3 ms [s].
_SCANNED = 0.15e-3


@kernel
def _split_reading(
    reading: Records, radial: Array, axes: int, span: float, currents: Array, temperatures: Array, field: Array,
    present: NDArray[np.bool_],
) -> tuple[float, float]:  # fmt: skip
    """Split a `reading` into currents (m,) [A], temperatures (m,) [K], field (k, 3) [T]; `present` by axis and block.
    Return the ages of currents and field [s]."""
    r = reading[0]
    for i in range(len(currents)):
        currents[i] = r.currents[i]
    temperatures[r.thermometer] = r.temperature
    if r.fresh and not np.isnan(r.hall[0]):
        fill_field(field, radial, axes, span, r.axis, r.first, r.hall[: r.count])
        present[r.axis, 0 if r.first == 0 else 1] = True
    return r.age, r.hall_age


@final
class BoardSample:
    """Latest currents, temperatures and field of `hall`, with their times."""

    def __init__(self, hall: HallSensors) -> None:
        self.hall = hall
        self._currents_at = self._field_at = 0.0
        self._nothing = hall.empty_field()
        self._currents, self._temperatures = np.zeros(CHANNELS), np.full(CHANNELS, np.nan)
        self._field = self._nothing.copy()
        self._present = np.zeros((3, len(BLOCKS)), np.bool_)
        self.update(make_reading(), 0.0)  # compiles in advance; no effect, as the reading has no new values
        self._temperatures[:] = np.nan

    def update(self, reading: Records, sent: float) -> None:
        """Update with a reading, (1,) BOARD_READING, that the firmware sent at `sent` [s], on the clock of `sample`."""
        hall = self.hall
        age, hall_age = _split_reading(
            reading, hall.radial, hall.axes, hall.span, self._currents, self._temperatures, self._field, self._present
        )  # fmt: skip
        self._currents_at = sent - age - _CONVERTED
        self._field_at = sent - hall_age - _SCANNED

    @property
    def complete(self) -> bool:
        """Whether every sensor has been read once."""
        return bool(self._present[: self.hall.axes].all() and np.isfinite(self._temperatures).all())

    def sample(self, now: float, pose: Pose) -> Sample:
        """Compose the sample at `now` [s]; field that was not reported since the last one is NaN."""
        field, self._field = self._field, self._nothing.copy()
        return Sample(
            now, self._currents.copy(), self._temperatures.copy(), field, pose,
            now - self._currents_at, now - self._field_at,
        )  # fmt: skip


_LOST_IN_A_ROW = 3  #: successive lost responses until the device counts as silent, while engaged
_LOST_AT_REST = 20  #: the same while not engaged: a busy computer is not a danger then
_REPEAT_AFTER_S = (
    5e-3  #: after this wait for a reply the request is repeated: 15 ms of silence switch the coils off [s]
)
_MAX_REPETITIONS = 10  #: most repetitions within the timeout: a long one is for an emulator slower than real time
_RETRY_INTERVAL_S = 0.25  #: between two attempts to reopen a lost port
_RECONNECT_TIMEOUT_S = 0.2  #: response timeout at reconnecting; no Arduino restarts in the middle of a loop
_REQUIRED = 0xFF  #: mask of all parts


@final
class SerialDriver(Driver):
    """Driver of three coils, current and temperature sensors and nine Hall sensors through the firmware at `path`.

    `write` sends the duties, or at rest a request, and returns at once; the response, with the readings, is collected
    by the next `read`. So a sample is one period old: it states the ages of its currents and its field. Each response
    contains one axis of four or five Hall sensors; the rest of a sample's `field` is NaN.

    The coils are engaged by the first duties that are not zero after `open` or `engage`. When the firmware trips, when
    the line falls silent or the port disappears, `read` raises DriverError with the reason, and duties are zero until
    the user calls `engage`, even if the port returns. A port that returns is reopened by the next `read`, 0.25 s later
    at the latest.

    pose(now) is the tracker's pose of the tool; without it no pose is ever valid. `timeout` [s] is how long `read`
    waits for the response to the last tick's frame, which is repeated every 5 ms meanwhile; the device counts as
    lost after three successive missing responses, twenty while no current may flow. A trip because this computer
    was silent is a HostSilent.
    duty_limit [1] and current_limit [A] are the limits sent to the firmware for this session; by default 5 % above
    the device's own current limit. `open` waits at most `warm_up` [s] for every sensor's first reading, and rejects a
    board whose Hall sensors have fewer than `hall_axes`. `clock` runs at the rate of the board's time: that of an
    emulated one may be slow.
    """

    simulated = False

    def __init__(
        self,
        device: Device,
        path: str,
        pose: Callable[[float], Pose] = invalid_pose,
        *,
        timeout: float = 5e-3,
        duty_limit: float = 1.0,
        current_limit: float | None = None,
        warm_up: float = 4.0,
        hall_axes: int = 1,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self._positions = check_electronics(device, "the serial protocol", "the firmware")
        self.name = f"serial:{path}"
        self._path = path
        self._pose = pose
        # above the guard's limit, which acts first; the firmware enforces this one
        limit = 1.05 * float(np.max(device.coils.current_limit)) if current_limit is None else current_limit
        self._session = (duty_limit, min(limit, 65.5))
        self._timeout = timeout
        self._clock = clock
        self._answer = 10 * timeout
        self._warm_up_time = warm_up
        self._hall_axes = hall_axes
        self._board: Board | None = None
        self._next_try = 0.0
        self._coils = CoilState.UNKNOWN
        self._start()

    def _start(self) -> None:
        self._armed = True  # the next non-zero duties may engage the coils
        self._engaged = False
        self._fault = ""
        self._lost = 0
        self._opened = False
        self._applied = np.zeros(CHANNELS)
        self._steps = np.zeros(CHANNELS, np.int64)
        quantise_duties(self._applied, self._steps)  # compiles in advance
        self._sample = BoardSample(HallSensors(self._positions))
        self._time = BoardTime(self._clock)

    @property
    def identity(self) -> Identity | None:
        """Identity of the connected device; None while there is none."""
        return None if self._board is None else self._board.identity

    @property
    def field_axes(self) -> Array | None:
        """(9, 3) unit vectors, if every Hall sensor measures only its radial component; None: three axes."""
        return self._sample.hall.directions

    @property
    def calibration(self) -> bytes | None:
        """Calibration id in the firmware's EEPROM."""
        return None if self._board is None else self._board.identity.calibration

    def remember(self, calibration: bytes) -> bool:
        """Write the id to the EEPROM and read it back; coils off."""
        if self._board is None:
            raise DriverError(f"the device at {self._path} is not open; nothing was stored")
        if self._board.is_posted:
            self._board.collect(self._timeout)
        self._engaged = False
        self._applied = np.zeros(CHANNELS)
        self._apply_mode(self._board.switch_off().mode)
        self._board.store_and_wait(calibration)
        return True

    @property
    def fault(self) -> str:
        """Reason why no current flows, in one clause; empty if it may."""
        return self._fault

    @property
    def coil_state(self) -> CoilState:
        """Coil state of the firmware's last response; UNKNOWN while it does not respond."""
        return self._coils

    def _apply_mode(self, mode: float) -> None:
        self._coils = CoilState.ON if mode == BoardMode.ENGAGED else CoilState.OFF

    def open(self) -> None:
        """Connect; wait until every sensor has been read once. Raises DriverError naming what is missing."""
        self.close()
        self._start()
        self._board = Board(self._path, answer=self._answer, clock=self._clock)
        self._opened = True
        try:
            self._adopt_identity(self._board.identity)
            self._warm_up(self._board)
        except BaseException:
            self.close()
            raise

    def _adopt_identity(self, identity: Identity) -> None:
        if identity.hall_axes < self._hall_axes:  # safety: board-axes
            raise DriverError(
                f"the board at {self._path} has Hall sensors of {identity.hall_axes} axis, the tracker 'hall' needs "
                f"{self._hall_axes}: use another tracker, or sensors and firmware for three axes (docs: hardware)"
            )
        self._sample = BoardSample(HallSensors(self._positions, identity.hall_axes))

    def _warm_up(self, board: Board) -> None:
        end = monotonic() + self._warm_up_time
        while True:
            reading = board.read_numbers()
            self._apply_mode(reading["mode"][0])
            self._sample.update(reading, 0.0)
            missing = int(reading["missing"][0])
            if self._sample.complete and not missing & _REQUIRED:
                return
            if monotonic() > end:
                parts = "; ".join(missing_chips(missing)) or "a sensor"
                raise DriverError(f"at {self._path} there is no response from: {parts}. Check wiring and supply")

    def close(self) -> None:
        """Coils off, then disconnect. May be called twice."""
        board, self._board = self._board, None
        self._opened = self._engaged = False
        self._applied = np.zeros(CHANNELS)
        if board is not None:
            self._coils = CoilState.OFF if board.close() else CoilState.UNKNOWN

    def engage(self) -> None:
        """Clear a trip when the user engages; the next duties that are not zero engage the coils."""
        if self._engaged:
            return
        self._armed = True
        self._fault = ""
        self._lost = 0
        if self._board is not None:
            try:
                if self._board.is_posted:
                    self._board.collect(self._timeout)
                self._apply_mode(self._board.switch_off().mode)
            except DriverError as cause:
                raise self._fail(str(cause), gone=True) from cause

    def _fail(self, why: str, *, gone: bool = False, as_: type[DriverError] = DriverError) -> DriverError:
        """Latch a failure: no current until `engage`."""
        self._armed = self._engaged = False  # safety: firmware-trip
        self._applied = np.zeros(CHANNELS)
        self._fault = why
        if gone:
            board, self._board = self._board, None
            self._next_try = monotonic() + _RETRY_INTERVAL_S
            self._coils = CoilState.UNKNOWN  # safety: serial-unknown
            if board is not None and board.close():
                self._coils = CoilState.OFF
        return as_(why)

    def _reconnect(self) -> Board:
        if monotonic() < self._next_try:
            raise DriverError(self._fault)
        self._next_try = monotonic() + _RETRY_INTERVAL_S
        try:
            self._board = Board(self._path, _RECONNECT_TIMEOUT_S, self._answer, self._clock)
        except DriverError as cause:
            self._next_try = monotonic() + _RETRY_INTERVAL_S
            raise DriverError(f"{self._fault}; retrying: {cause}") from cause
        return self._board

    def read(self, now: float) -> Sample:
        """Return the sample at `now` [s] from the response to the last tick's frame."""
        if not self._opened:
            raise DriverError(f"the device at {self._path} is not open; use it in a `with` block or call open() first")
        self._time.tick(now)
        board = self._board or self._reconnect()
        try:
            if not board.is_posted:
                board.post(None)
            reading = self._collect_reply(board)
        except DriverError as cause:
            raise self._fail(str(cause), gone=True) from cause
        if reading is None:
            self._lost += 1
            if self._lost >= (_LOST_IN_A_ROW if self._engaged else _LOST_AT_REST):
                raise self._fail(f"no response from the firmware at {self._path}; check cable and supply", gone=True)
        else:
            self._lost = 0
            mode = reading["mode"][0]
            self._apply_mode(mode)
            self._sample.update(reading, self._time.time_of_answer(board.asked))
            if mode != BoardMode.ENGAGED:
                reading_facts = Reading.of(reading)
                why = explain_off(reading_facts, self._engaged)
                if why:
                    silent = reading_facts.reason is Reason.SILENCE
                    raise self._fail(why, as_=HostSilent if silent else DriverError)
        return self._sample.sample(now, self._pose(now))

    def _collect_reply(self, board: Board) -> Records | None:
        """Collect the response to the last request, or to any of its repetitions, which are sent meanwhile."""
        end, pause = monotonic() + self._timeout, max(_REPEAT_AFTER_S, self._timeout / _MAX_REPETITIONS)
        while True:
            left = end - monotonic()
            reading = board.collect(min(left, pause))
            if reading is not None or left <= pause:
                return reading
            board.repeat(self._steps if self._engaged else None)  # safety: waiting-heard

    def write(self, duties: Array) -> Array:
        """Send `duties` (3,); return those applied (3,): in the PWM's steps, zeros while the coils are off."""
        if duties.shape != (CHANNELS,):
            raise InputError(f"duties must have one entry per coil, shape ({CHANNELS},); got shape {duties.shape}")
        some = quantise_duties(duties, self._steps)
        board = self._board
        if board is None or not self._opened:
            return np.zeros(CHANNELS)
        try:
            if not (self._engaged or (self._armed and some)):
                if not board.is_posted:
                    # safety: rest-asked
                    board.post(None)  # so that the next tick need not wait for the whole response
                return np.zeros(CHANNELS)
            why = "" if self._engaged else self._refusal(board)
            if not why:
                board.post(self._steps)
        except DriverError as cause:
            raise self._fail(str(cause), gone=True) from cause
        if why:
            raise self._fail(f"the firmware refused to engage: {why}")
        self._engaged = True
        self._applied = self._steps / DUTY_STEPS
        return self._applied.copy()

    def _refusal(self, board: Board) -> str:
        """Engage; return the reason if the firmware refuses, else an empty text."""
        if board.is_posted:
            board.collect(self._timeout)
        self._armed = False
        self._coils = CoilState.ON  # possible from here on
        state = board.engage(*self._session)
        self._apply_mode(state.mode)
        return refusal(state)


load_compiler()  # at import, so that no device waits for it
