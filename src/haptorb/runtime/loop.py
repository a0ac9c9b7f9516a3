"""The real-time loop: wait for the deadline, execute commands, step, publish, count. All exits switch the coils off."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from time import monotonic_ns
from typing import final

import numpy as np

from haptorb.arrays import Array, Records
from haptorb.compiled import kernel
from haptorb.control.linkage import MODES
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.errors import HaptorbError, InputError
from haptorb.runtime.black_box import StateKeeper
from haptorb.runtime.clock import Clock
from haptorb.runtime.linux import TickTimeout, is_parent_gone
from haptorb.runtime.liveness import LATE_HEARTBEAT_S, HostHeartbeat, ProcessorWait, state_of
from haptorb.runtime.shared_memory import BINS, COUNTS, Phase, SharedMemory, Word, engage_stops, find_end_signal
from haptorb.runtime.tick import Chain, render_world
from haptorb.runtime.tick_log import NO_TICK
from haptorb.runtime.tick_state import TickState
from haptorb.runtime.world_loading import LoadedWorld, WorldLoader
from haptorb.runtime.world_requests import answer, change_world, description, name_of, parse_request, postponement
from haptorb.worlds.base import World
from haptorb.worlds.client_force import join_remote, split_remote

__all__ = ["Loop", "count_tick", "load_loop", "publish_row"]


# --------------------------------------------------------------------------------------------------
# Per-tick output of the loop, in two compiled passes: publish the row, and count for the report.


_LAST = BINS - 1


@kernel
def _size(row: Array, at: int) -> float:
    return float(np.sqrt(row[at] * row[at] + row[at + 1] * row[at + 1] + row[at + 2] * row[at + 2]))


@kernel
def publish_row(
    row: Array, slot: Array, places: Records, counts: Records, tick: int, now: int, lateness: int, skipped: int
) -> None:  # fmt: skip
    """Complete `row` with the clock's values, all in [ns], and the hand's signals; copy it to `slot`; both (width,).

    places is that of the `RowLayout`; counts (1,) COUNTS, with the peak force [N] and torque [N·m] so far.
    """
    at, most = places[0], counts[0]
    row[at.tick], row[at.wall], row[at.lateness], row[at.missed] = tick, now * 1e-9, lateness * 1e-9, skipped
    row[at.buttons], row[at.grip], row[at.hand_t] = most.buttons | most.hand_buttons, most.grip, most.hand_t
    for i in range(row.shape[0]):
        slot[i] = row[i]
    given = at.wrench_actual
    force = _size(row, given)
    if force != force:  # the actual wrench is unknown
        given = at.wrench_model
        force = _size(row, given)
    if force > most.peak:
        most.peak = force
    torque = _size(row, given + 3)
    if torque > most.peak_torque:
        most.peak_torque = torque


@kernel
def count_tick(counts: Records, ticks: int, missed: int, lateness: int, took: int, period: int) -> None:
    """Count one tick's lateness and computing time [ns], and whether it met its deadline; counts (1,) COUNTS.

    The bins are those of a `Histogram`.
    """
    c = counts[0]
    c.lateness[min(max(lateness, 0) // 1000, _LAST)] += 1
    c.compute[min(max(took, 0) // 1000, _LAST)] += 1
    c.ticks, c.missed = ticks, missed
    if lateness + took <= period:
        c.on_time += 1


_LATE_HEARTBEAT_NS = int(LATE_HEARTBEAT_S * 1e9)
_STANDSTILL_NS = 100_000_000  #: gap without a tick after which the heartbeat timeout of the host restarts
_TRIPPED = float(GuardState.TRIPPED)
_PARENT_CHECK_INTERVAL_S = 0.05  #: between two checks whether the parent runs
_MAX_ERROR_CHARACTERS = 4000  #: characters of the error of a failed world or driver
_AVERAGED_TICKS = 64  #: ticks over which the computing time is averaged
_MAX_AVERAGED_PERIODS = 4  #: cap on one tick in that average [periods]: the computer may pause in the middle of it
_STOP_GRACE_S = 0.25  #: after a signal to the host: delay before its Stop is announced as a trip
_WATCHDOG_TIMEOUT_S = 2.0  #: watchdog timeout: without a tick for this long the kernel kills the process


@final
class Loop:
    """Steps `chain` at `rate` [Hz] and publishes its rows in `shared`, until a request to end or a failure."""

    def __init__(
        self,
        chain: Chain,
        world: World,
        shared: SharedMemory,
        rate: float,
        parent: int,
        put_off: Callable[[float], None] = lambda seconds: None,
        *,
        own_worlds: Mapping[str, World] | None = None,
        loader: WorldLoader | None = None,
        state: TickState | None = None,
    ) -> None:
        self._chain = chain
        self._world = world
        self._own, self._loader = dict(own_worlds or {}), loader
        self._states = None if state is None else StateKeeper(state, shared.states)
        self._shared = shared
        self._parent = parent
        patient = chain.driver.simulated  # safety: host-starved-real
        self._host = HostHeartbeat(state_of(parent), ProcessorWait(parent).update if patient else None)
        self._put_off, self._every = put_off, max(1, int(rate * _PARENT_CHECK_INTERVAL_S))
        self._rate = rate
        self._row = shared.layout.empty()
        # Scalar access through a memoryview is ten times faster than through an array.
        self._cells = self._row.data.cast("B").cast("d")
        load_loop(self._row, shared.layout.places)
        self._ticks = 0
        self._now = 0.0  # on the loop's clock [s]
        self._work = 0.0  # average computing time of a tick [ns]
        # safety: start-stop
        self._stopped = 0  # a stop during the start takes effect in the first tick
        self._engaged = shared.words[Word.ENGAGE]
        self._mode, self._clutch, self._model, self._scale, self._cooled = 0, 0, 0, 0, 0
        self._asked = shared.request.version
        self._guard = shared.layout["guard"].start
        self._places = shared.layout.places
        self._tripped = False
        self._quiet = 0  # first tick in which a trip is announced
        self.end_signal = ""  #: name of a signal, set by its handler: the loop ends after the current tick
        self.in_step = False  #: whether the chain is being stepped
        self.reason = ""  #: why the loop ended; empty: on request

    @property
    def world(self) -> str:
        """Name of the rendered world."""
        return name_of(self._world)

    def run(self, clock: Clock) -> bool:
        """Run to the end, close the driver and publish the last row; True if it ended on request."""
        failed: Trip | None = None
        try:
            failed = self._run_ticks(clock)
        except BaseException as cause:  # not only `Exception`: a tick timeout, an exit
            self._close_driver()  # first of all; the explanation follows
            failed = Trip.LOOP_FAILED
            self.reason = _explain_failure(cause)
        finally:
            if not self._close_driver() and failed is None:
                failed = Trip.DRIVER_FAILED
            self._last_row(failed)
        return failed is None

    def _close_driver(self) -> bool:
        """Close the driver: coils off. If that fails, set the reason and return False."""
        self.in_step = False
        try:
            self._chain.driver.close()
        except Exception as cause:
            self.reason = f"the driver did not close: {_explain_failure(cause)}"
            return False
        return True

    def _run_ticks(self, clock: Clock) -> Trip | None:
        """Tick until a request to end (None) or until the host is gone (HOST_SILENT)."""
        shared, chain, row, words, at = self._shared, self._chain, self._row, self._shared.words, self._places
        schedule, period = clock.schedule, clock.schedule.period
        ring, counts, forces = shared.ring, shared.counts, shared.client_forces
        timeout_start = 0  # when the heartbeat timeout was last restarted [ns]
        words[Word.ORIGIN] = schedule.origin
        words[Word.PHASE] = Phase.RUNNING
        while True:
            following = schedule.time(schedule.deadline(schedule.number + 1))
            deadline = clock.sleep()
            chain.prepare(deadline)
            now, lateness, skipped = clock.wait()
            if skipped and (deadline == following or self._work < period):  # not caused by a tick's own work
                chain.exclude_next_lateness()
            if self.end_signal or words[Word.QUIT]:
                return None
            if skipped * period > _STANDSTILL_NS:  # the same cause delayed the host's heartbeat
                timeout_start = now
            silence = now - max(words[Word.HEARTBEAT], timeout_start)
            if silence > _LATE_HEARTBEAT_NS:  # safety: host-silent
                self.reason = self._host.explain_silence(now, silence)
                if self.reason:
                    return Trip.HOST_SILENT
            if self._ticks % self._every == 0:
                self._put_off(_WATCHDOG_TIMEOUT_S)
                if is_parent_gone(self._parent):
                    self.reason = "the program that started the servo ended"
                    return Trip.HOST_SILENT
            self._execute_requests()
            self.in_step = True
            self._now = schedule.time(schedule.deadline(schedule.number))
            forces.fill(chain.client, 1e-9 * now)
            chain.step(row, self._now)
            self.in_step = False
            publish_row(row, ring.slot(), at, counts, self._ticks, now, lateness, skipped)
            ring.publish_slot()
            self._ticks += 1
            self._announce_trip()
            if self._states is not None and 2.0 * self._work < period:
                self._states.update(self._ticks - 1)
            took = monotonic_ns() - now
            self._work += (min(took, _MAX_AVERAGED_PERIODS * period) - self._work) / _AVERAGED_TICKS
            count_tick(counts, self._ticks, schedule.missed, lateness, took, period)

    def _execute_requests(self) -> None:
        """Execute the host's requests since the last tick: stop, engage, cool, mode, clutch, world."""
        words = self._shared.words
        stops, engage = words[Word.STOP], words[Word.ENGAGE]
        if stops != self._stopped:
            self._stopped = stops
            self._chain.stop()
        if engage != self._engaged:
            self._engaged = engage
            # An engage request from before the last stop is void, however late it arrives.
            if engage_stops(engage) == stops & 0xFFFF_FFFF:  # safety: engage-void
                # After engaging, a world that fails again in the next tick is another trip.
                self._tripped = not self._chain.engage() and self._tripped
        one, other = self._shared.signals
        if (one[0] and find_end_signal(one)) or (other[0] and find_end_signal(other)):  # safety: signal-read
            self._chain.stop()
            self._quiet = self._ticks + int(_STOP_GRACE_S * self._rate)
        if words[Word.MODE] != self._mode:
            self._mode = words[Word.MODE]
            self._chain.joining.set_mode(MODES[self._mode - 1])
        if words[Word.MODEL] != self._model:
            self._model = words[Word.MODEL]
            with suppress(InputError):  # the host requests only what the device has
                self._chain.change_model(self._model - 1)
        if words[Word.SCALE] != self._scale:
            self._scale = words[Word.SCALE]
            self._chain.joining.set_torque_scale(1e-6 * float(self._scale))
        if words[Word.COOL] != self._cooled:
            self._cooled = words[Word.COOL]
            self._chain.cool()
        if words[Word.CLUTCH] != self._clutch:
            self._clutch = words[Word.CLUTCH]
            self._chain.joining.set_clutch(self._clutch == 1)
        if self._shared.request.version != self._asked:
            self._asked, text = self._shared.request.read()
            if text:
                self._take_request(text)
        if self._loader is not None and (loaded := self._loader.ready) is not None:
            self._loader.ready = None
            self._shared.answer.write(self._apply_loaded_world(loaded))

    def _take_request(self, text: str) -> None:
        """Change the world now, or start loading its code, or a new version of a user's world, in the loader thread."""
        number, name, values, file = parse_request(text)
        make = partial(change_world, self._world, name, values, self._own)
        if self._loader is None:
            reply = self._change(number, name, make, self._render)
        elif file:
            self._loader.load(number, name, Path(file))
            return
        elif name not in self._own and self._loader.is_code_missing(name):
            self._loader.prepare(number, name, make)
            reply = postponement(number)
        else:
            reply = self._change(number, name, make, self._render)
        self._shared.answer.write(reply)

    def _apply_loaded_world(self, loaded: LoadedWorld) -> str:
        """Render a catalogue world whose code has been loaded, or replace a user's world; return the answer as JSON."""
        world = loaded.world
        if world is None:
            return answer(loaded.number, loaded.error)
        if not loaded.own:
            return self._change(loaded.number, loaded.name, lambda: world, self._render)
        if loaded.name == name_of(self._world):
            joined = join_remote(world, split_remote(self._world)[1])
            reply = self._change(loaded.number, loaded.name, lambda: joined, self._chain.replace_world)
            if self._world is not joined:
                return reply
        self._own[loaded.name] = world
        return answer(loaded.number)

    def _render(self, world: World) -> None:
        render_world(self._chain, world, self._world)

    def _change(self, number: int, name: str, make: Callable[[], World], render: Callable[[World], None]) -> str:
        """Call `render` with the world that `make` returns, for request `number`; return the answer as JSON."""
        try:
            world = make()
            render(world)
            self._shared.announce_world(description(world))
        except HaptorbError as cause:
            return answer(number, cause)
        except Exception as cause:  # a world is user code
            return answer(number, HaptorbError(f"world '{name}' failed to change: {type(cause).__name__}: {cause}"))
        self._world = world
        return answer(number)

    def _announce_trip(self) -> None:
        """Publish each trip once."""
        tripped = self._cells[self._guard] == _TRIPPED
        if tripped and self._ticks < self._quiet:  # a program that ends is not notified of its own stop
            return
        if tripped and not self._tripped:
            if self._states is not None:
                self._states.mark_trip(self._ticks - 1, self._now)
            self._shared.error.write(self._chain.error[:_MAX_ERROR_CHARACTERS])  # first: a trip's reader reads it
            self._shared.announce_trip(self._now, self._cells[self._shared.layout["trip"].start])
        self._tripped = tripped

    def _last_row(self, failed: Trip | None) -> None:
        """Publish a final row with the coils off. Measured values are repeated from the row before."""
        shared, row, at = self._shared, self._row, self._shared.layout
        if self._ticks == 0:
            row[:] = 0.0
        row[at["tick"]] = self._ticks
        row[at["wall"]] = monotonic_ns() * 1e-9
        row[at["lateness"]] = row[at["missed"]] = row[at["gain"]] = 0.0
        row[at["wrench_commanded"]] = row[at["current_commanded"]] = row[at["duty_applied"]] = 0.0
        row[at["guard"]] = GuardState.OFF if failed is None else GuardState.TRIPPED
        row[at["trip"]] = Trip.CLOSING if failed is None else failed
        row[at["coil_state"]] = self._chain.driver.coil_state
        row[at["commands"]] = NO_TICK
        if failed is not None:
            shared.announce_trip(self._now, failed)
        shared.ring.publish(row)


def load_loop(row: Array, places: Records) -> None:
    """Load the loop's compiled code before the first tick; `row` (width,) [SI] is NaN afterwards."""
    counts = np.zeros(1, dtype=COUNTS)
    publish_row(row, row.copy(), places, counts, 0, 0, 0, 0)
    count_tick(counts, 0, 0, 0, 0, 1)
    row[:] = np.nan


def _explain_failure(cause: BaseException) -> str:
    """Describe the failure in one line; an unexpected one with file and line."""
    if isinstance(cause, HaptorbError | TickTimeout):
        return str(cause)
    frames = traceback.extract_tb(cause.__traceback__)
    where = f" ({frames[-1].filename}, line {frames[-1].lineno})" if frames else ""
    return f"{type(cause).__name__}: {cause}{where}"
