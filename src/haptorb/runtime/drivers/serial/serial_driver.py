"""The driver of a real device behind a serial port: one frame each way per tick, and no current without intent."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic
from typing import final

import numpy as np

from haptorb.control.protection.trip import CoilState
from haptorb.devices.device import Device
from haptorb.errors import DriverError, HostSilent, InputError
from haptorb.numerics.arrays import Array, Records
from haptorb.runtime.drivers.driver import Driver
from haptorb.runtime.drivers.electronics import CHANNELS, DUTY_STEPS, check_electronics, invalid_pose, quantise_duties
from haptorb.runtime.drivers.hall_sensor import HallSensors
from haptorb.runtime.drivers.serial.board import Board
from haptorb.runtime.drivers.serial.codes import BoardMode, Reason, missing_chips
from haptorb.runtime.drivers.serial.messages import explain_off, refusal
from haptorb.runtime.drivers.serial.reading import Reading
from haptorb.runtime.drivers.serial.replies import Identity
from haptorb.runtime.drivers.serial.reply_time import BoardTime
from haptorb.runtime.drivers.serial.sample_parts import BoardSample
from haptorb.sensing.sample import Pose, Sample

__all__ = ["SerialDriver"]

_LOST_IN_A_ROW = 3  #: repeated readings until the device counts as silent, with current in its coils
_LOST_AT_REST = 20  #: the same while it is not engaged: a busy computer is no danger then
_SAY_AGAIN = 5e-3  #: after this wait for a reply the request is repeated: 15 ms of silence switch the coils off [s]
_TIMES = 10  #: at most, in all of the patience: who has much of it has an emulator that runs slower than time
_RETRY = 0.25  #: between two attempts to reach a port that has gone [s]
_MEETING = 0.2  #: for an answer when the port is back [s]; no Arduino restarts in the middle of a loop
_REQUIRED = 0xFF  #: every part


@final
class SerialDriver(Driver):
    """Three coils, their currents and temperatures and nine Hall sensors behind the firmware at `path`.

    `write` sends the duties, or at rest a question, and returns at once; the answer, with the readings, is collected by
    the next `read`. So a sample is one period old: it says how old its currents and its field are. Each answer brings
    one axis of four or five Hall sensors; the rest of a sample's `field` is NaN.

    The coils are engaged by the first duties that are not zero after `open` or `engage`. When the firmware trips, when
    the line falls silent or the port disappears, `read` raises DriverError with the reason, duties are zero, and stay
    zero, port or no port, until `engage` is called: that is for a person to do. A port that comes back is found again
    by the next `read`, a quarter of a second later at the latest.

    pose(now) is the tracker's word on where the tool is; without it no pose is ever valid. `patience` [s] is how long
    `read` waits for the answer to the last tick's frame, sent again every 5 ms meanwhile; three unanswered in a row are
    a device that has gone, twenty while no current may flow. A trip because this computer was silent is a HostSilent.
    duty_limit [1] and current_limit [A] are the limits sent to the firmware for this session; by default 5 % above
    the device's own current limit. `open` waits at most `warm_up` [s] for every sensor's first reading, and refuses a
    board whose Hall sensors have fewer than `hall_axes`. `clock` runs as fast as the board's time does: an emulated one
    may be slow.
    """

    simulated = False

    def __init__(
        self,
        device: Device,
        path: str,
        pose: Callable[[float], Pose] = invalid_pose,
        *,
        patience: float = 5e-3,
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
        # the guard's limit first, then this one, which the firmware holds by itself
        limit = 1.05 * float(np.max(device.coils.current_limit)) if current_limit is None else current_limit
        self._session = (duty_limit, min(limit, 65.5))
        self._patience = patience
        self._clock = clock
        self._answer = 10 * patience
        self._warm_up_time = warm_up
        self._hall_axes = hall_axes
        self._board: Board | None = None
        self._next_try = 0.0
        self._coils = CoilState.UNKNOWN
        self._start()

    def _start(self) -> None:
        self._armed = True  # the next duties may engage the coils
        self._engaged = False
        self._fault = ""
        self._lost = 0
        self._opened = False
        self._applied = np.zeros(CHANNELS)
        self._steps = np.zeros(CHANNELS, np.int64)
        quantise_duties(self._applied, self._steps)  # compiled before anybody waits
        self._sample = BoardSample(HallSensors(self._positions))
        self._time = BoardTime(self._clock)

    @property
    def identity(self) -> Identity | None:
        """The device that responds; None while none does."""
        return None if self._board is None else self._board.identity

    @property
    def field_axes(self) -> Array | None:
        """(9, 3) unit vectors, if every Hall sensor looks along its own radius only; None: three axes."""
        return self._sample.hall.directions

    @property
    def calibration(self) -> bytes | None:
        """The id in the firmware's EEPROM."""
        return None if self._board is None else self._board.identity.calibration

    def remember(self, calibration: bytes) -> bool:
        """Write the id into the EEPROM and read it back; coils off."""
        if self._board is None:
            raise DriverError(f"the device at {self._path} is not open; nothing was stored")
        if self._board.is_posted:
            self._board.collect(self._patience)
        self._engaged = False
        self._applied = np.zeros(CHANNELS)
        self._apply_mode(self._board.switch_off().mode)
        self._board.keep(calibration)
        return True

    @property
    def fault(self) -> str:
        """Why no current flows, in one clause; empty if it may."""
        return self._fault

    @property
    def coil_state(self) -> CoilState:
        """As the firmware said last; UNKNOWN from the moment at which it does not answer until it does."""
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
            self._sample.take(reading, 0.0)
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
        """A person wants the coils on again: forget a trip; the next duties that are not zero engage them."""
        if self._engaged:
            return
        self._armed = True
        self._fault = ""
        self._lost = 0
        if self._board is not None:
            try:
                if self._board.is_posted:
                    self._board.collect(self._patience)
                self._apply_mode(self._board.switch_off().mode)
            except DriverError as cause:
                raise self._fail(str(cause), gone=True) from cause

    def _fail(self, why: str, *, gone: bool = False, as_: type[DriverError] = DriverError) -> DriverError:
        """No current from now on, until `engage`."""
        self._armed = self._engaged = False  # safety: firmware-trip
        self._applied = np.zeros(CHANNELS)
        self._fault = why
        if gone:
            board, self._board = self._board, None
            self._next_try = monotonic() + _RETRY
            self._coils = CoilState.UNKNOWN  # safety: serial-unknown
            if board is not None and board.close():
                self._coils = CoilState.OFF
        return as_(why)

    def _reconnect(self) -> Board:
        if monotonic() < self._next_try:
            raise DriverError(self._fault)
        self._next_try = monotonic() + _RETRY
        try:
            self._board = Board(self._path, _MEETING, self._answer, self._clock)
        except DriverError as cause:
            self._next_try = monotonic() + _RETRY
            raise DriverError(f"{self._fault}; retrying: {cause}") from cause
        return self._board

    def read(self, now: float) -> Sample:
        """The sample at `now` [s]: the answer to what the last tick sent."""
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
            self._sample.take(reading, self._time.time_of_answer(board.asked))
            if mode != BoardMode.ENGAGED:
                reading_facts = Reading.of(reading)
                why = explain_off(reading_facts, self._engaged)
                if why:
                    silent = reading_facts.reason is Reason.SILENCE
                    raise self._fail(why, as_=HostSilent if silent else DriverError)
        return self._sample.sample(now, self._pose(now))

    def _collect_reply(self, board: Board) -> Records | None:
        """The answer to the last question; meanwhile the same is asked again, and any of the answers will do."""
        end, pause = monotonic() + self._patience, max(_SAY_AGAIN, self._patience / _TIMES)
        while True:
            left = end - monotonic()
            reading = board.collect(min(left, pause))
            if reading is not None or left <= pause:
                return reading
            board.repeat(self._steps if self._engaged else None)  # safety: waiting-heard

    def write(self, duties: Array) -> Array:
        """Send `duties` (3,); returns (3,) what was applied: in the PWM's steps, zeros while the coils are off."""
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
                    board.post(None)  # so that the next tick need not wait for all of the answer
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
        """Engage; why the firmware does not want to, or nothing."""
        if board.is_posted:
            board.collect(self._patience)
        self._armed = False
        self._coils = CoilState.ON  # from here on it may be
        state = board.engage(*self._session)
        self._apply_mode(state.mode)
        return refusal(state)
