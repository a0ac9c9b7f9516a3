"""One tick of the loop: read → estimate → world → allocate → guard → write, and its row.

The same sequence runs every device, simulated or real, without a case distinction.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from queue import SimpleQueue
from threading import Thread
from time import perf_counter, thread_time
from typing import Any, Protocol, final

import numpy as np

from haptorb.arrays import Array, Records, StateArray, Stateful, choose, make_block, make_numbers
from haptorb.compiled import kernel, tick_kernel
from haptorb.compiled import load_compiler as load_compiler
from haptorb.control.allocation import PART_NUMBERS, Allocation, Allocator, WrenchChoice
from haptorb.control.gripper import GripperGuard
from haptorb.control.linkage import MODES, Direct, Linkage, Mode, RenderedWrench
from haptorb.control.protection import Protection
from haptorb.control.saturation import Saturation
from haptorb.control.trip_reasons import Trip
from haptorb.devices.base import Device, State, WrenchMap
from haptorb.devices.gripper import find_gripper
from haptorb.errors import HaptorbError
from haptorb.estimation.types import Estimate, Estimator
from haptorb.recording.row import STAGES, RowLayout
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.linux import TickTimeout
from haptorb.runtime.tick_log import NotedLinkage, TickCommand, TickFailure, TickLog
from haptorb.worlds.base import PARTS, World, WrenchPart, is_other_world
from haptorb.worlds.client_force import split_remote
from haptorb.worlds.dynamic import (
    BoundWorld,
    MemoryNotFinite,
    WorldWork,
    bind_world,
    check_world_period,
    make_client_force,
)
from haptorb.worlds.user_world import check_wrench, describe_failure

__all__ = [
    "Chain",
    "Joining",
    "RenderedPart",
    "StepWatch",
    "Tick",
    "WorkThread",
    "WorldBudget",
    "explain_trip",
    "fill_object",
    "fill_pose",
    "fill_quaternion",
    "fill_row",
    "fill_silent_row",
    "render_world",
]


# --------------------------------------------------------------------------------------------------
# Selection of force, torque or full wrench rendering: configured, or detected from the world's wrench.


_NO_CHOICE = -1.0


@final
class RenderedPart(Stateful):
    """The active allocator and its number in the row, −1 for a device without a choice.

    wrench     (6,) the world's wrench of this tick [N, N·m], filled by the tick
    is_open    whether the part still follows from the wrenches
    """

    def __init__(
        self, allocator: Allocator, choice: WrenchChoice | None, protection: Protection, wrench: Array
    ) -> None:
        self.allocator, self.number, self.is_open = allocator, _NO_CHOICE, False
        self._choice, self._protection = choice, protection
        self._numbers = wrench.data.cast("B").cast("d")  # scalar access through it is ten times faster
        self._part: WrenchPart = "force"
        self._has_pushed = False
        self._kept = make_numbers("number", "is_open", "part", "has_pushed")

    def state_arrays(self) -> Mapping[str, StateArray]:
        """State: the part by its numbers in the row and in `PARTS`, whether it may change, whether a force occurred."""
        return {"part": self._kept[0]}

    def gather_state(self) -> None:
        """Copy the part to the state arrays."""
        cells = self._kept[1]
        cells[0], cells[1], cells[2], cells[3] = self.number, self.is_open, PARTS.index(self._part), self._has_pushed

    def apply_state(self) -> None:
        """Restore the part, with its allocator."""
        self.number, is_open, part, has_pushed = self._kept[1]
        self.is_open, self._has_pushed = bool(is_open), bool(has_pushed)
        self._part = PARTS[choose(part, len(PARTS))]
        if self._choice is not None:
            self.allocator = self._choice.allocators[self._part]

    def begin(self, world: World) -> None:
        """Select the configured part, else the one that `world` declares."""
        if self._choice is None:
            return
        opens = self._choice.is_open(world)
        if not (opens and self.is_open):  # the same world with other values: parts detected before still count
            self._has_pushed = False
            self._render(self._choice.choose_part(world))
        self.is_open = opens

    def follow(self) -> None:
        """Add the part that occurs in the world's wrench for the first time in this tick."""
        n = self._numbers
        pushes = bool(n[0] or n[1] or n[2])
        if self._part == "force" and (n[3] or n[4] or n[5]):
            self._render("both" if pushes or self._has_pushed else "torque")
        elif self._part == "torque" and pushes:
            self._render("both")
        self._has_pushed = self._has_pushed or pushes

    def _render(self, part: WrenchPart) -> None:
        assert self._choice is not None
        self._part, self.number = part, float(PART_NUMBERS[part])
        self.allocator = self._choice.allocators[part]
        arm = 0.0 if part == "force" else self._choice.arm
        self._protection.change_part(pushes=part != "torque", arm=arm)  # safety: turns-are-counted


# --------------------------------------------------------------------------------------------------
# The row of a tick in which the device did not respond: nothing was measured, and no wrench is requested.


def fill_silent_row(row: Array, layout: RowLayout, protection: Protection, coil_state: float, now: float) -> None:
    """Fill `row` (width,), at `now` [s] on the loop's clock, with the values that are known without measurements, each
    in the unit of its field; NaN elsewhere."""
    row[:] = np.nan
    row[layout["t"]] = now
    row[layout["guard"]] = protection.guard_state
    row[layout["trip"]] = protection.reason
    row[layout["coil_state"]] = coil_state
    row[layout["gain"]] = row[layout["valid"]] = row[layout["current_commanded"]] = 0.0


# --------------------------------------------------------------------------------------------------
# Filling the row of a tick: all arrays, in two compiled passes.


@kernel
def _copy(row: Array, start: int, values: Array) -> None:
    for i in range(values.size):
        row[start + i] = values[i]


@kernel
def _copy_table(row: Array, start: int, values: Array) -> None:
    width = values.shape[1]
    for k in range(values.shape[0]):
        for i in range(width):
            row[start + width * k + i] = values[k, i]


@kernel
def fill_quaternion(R: Array, q: Array) -> None:
    """Fill q (4,) with the quaternion (x, y, z, w) of R (3, 3): the largest of four candidates (Shepperd's method)."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    pick, best = 3, trace
    for i in range(3):
        if R[i, i] > best:
            pick, best = i, R[i, i]
    if pick == 3:
        s = 2.0 * np.sqrt(max(1.0 + trace, 0.0))
        q[3] = 0.25 * s
        q[0] = (R[2, 1] - R[1, 2]) / s
        q[1] = (R[0, 2] - R[2, 0]) / s
        q[2] = (R[1, 0] - R[0, 1]) / s
    else:
        i, j, k = pick, (pick + 1) % 3, (pick + 2) % 3
        s = 2.0 * np.sqrt(max(1.0 + R[i, i] - R[j, j] - R[k, k], 0.0))
        q[i] = 0.25 * s
        q[j] = (R[j, i] + R[i, j]) / s
        q[k] = (R[k, i] + R[i, k]) / s
        q[3] = (R[k, j] - R[j, k]) / s


@tick_kernel
def fill_row(
    row: Array, places: Records, state: Records, coils: Records, hand_goal: Array, wrench_actual: Array,
    duty_applied: Array, field: Array, stages: Array,
) -> None:  # fmt: skip
    """Fill the fields of `row` (width,) on device and protection, at the `places` of the `RowLayout`.

    state (1,) PROTECTION and coils (m,) COIL; hand_goal (7,) position [m] and quaternion; wrench_actual
    (6,) [N, N·m]; duty_applied (m,) of the driver; field (k, 3) [T]; stages (7,) [s].
    """
    at, s = places[0], state[0]
    e, g, heat, passivity = s.estimate, s.guard, s.heat, s.passivity
    row[at.t], row[at.valid], row[at.age] = s.clock.time, e.valid, e.age
    _copy(row, at.p, e.position[:])
    fill_quaternion(e.rotation[:], row[at.q : at.q + 4])
    _copy(row, at.v, e.velocity[:])
    _copy(row, at.w, e.angular_velocity[:])
    _copy(row, at.hand_goal, hand_goal)  # and hand_goal_q, which follows
    _copy(row, at.wrench_commanded, g.wrench_commanded[:])
    _copy(row, at.wrench_actual, wrench_actual)
    _copy(row, at.duty_applied, duty_applied)
    for i in range(6):
        row[at.wrench_model + i] = 0.0
    for j in range(coils.size):
        c = coils[j]
        row[at.current_commanded + j], row[at.current_measured + j] = c.current_commanded, c.current
        row[at.resistance + j], row[at.duty_commanded + j] = c.resistance, c.duty
        row[at.boundary + j], row[at.winding + j] = c.boundary, c.winding
        for i in range(6):
            row[at.wrench_model + i] += c.wrench[i] * c.current
    _copy_table(row, at.field, field)
    _copy(row, at.stages, stages)
    row[at.guard], row[at.trip], row[at.gain], row[at.remaining] = g.state, g.reason, g.gain, heat.remaining
    row[at.energy], row[at.balance], row[at.injected] = passivity.energy, passivity.balance, passivity.damping
    row[at.softened] = passivity.softened


@tick_kernel
def fill_pose(
    row: Array, at: int, R: Array, p: Array, v: Array, w: Array, t: float, valid: bool, currents_age: float,
    field_age: float,
) -> None:  # fmt: skip
    """Fill the fields of `row` (width,) from `at` on, the index of `currents_age`: ages of the readings [s], then the
    tracker's pose, that of a `Sample`, p [m], v [m/s], w [rad/s], t [s].

    A single index instead of the record of all places: numba unpacks it three times faster.
    """
    row[at], row[at + 1], row[at + 2], row[at + 3] = currents_age, field_age, t, valid
    for i in range(3):
        row[at + 4 + i], row[at + 16 + i], row[at + 19 + i] = p[i], v[i], w[i]
        for j in range(3):
            row[at + 7 + 3 * i + j] = R[i, j]


@tick_kernel
def fill_object(
    row: Array, places: Records, share: Array, p: Array, R: Array, wrench: Array, contacts: Array, memory: Array,
    held: Array,
) -> None:  # fmt: skip
    """Fill the fields of `row` (width,) on the object that the world acts on, at the `places` of the `RowLayout`.

    share (2,), p (3,) [m], R (3, 3), wrench (6,) [N, N·m] and contacts (n, 8) as a `RenderedWrench` has them: the row
    contains as many as it has room for, and missing ones are zero. memory (n,) of a world, in its own units: as
    much as there is room for, then NaN. held (14 + …,) becomes share, p, R and contacts.
    """
    at = places[0]
    for i in range(2):
        held[i] = share[i]
    for i in range(3):
        held[2 + i] = p[i]
        for j in range(3):
            held[5 + 3 * i + j] = R[i, j]
    for i in range(held.size - 14):
        held[14 + i] = contacts[i // 8, i % 8] if i < contacts.size else 0.0
    _copy(row, at.clutch_share, share)
    _copy(row, at.object, p)
    fill_quaternion(R, row[at.object_q : at.object_q + 4])
    _copy(row, at.object_wrench, wrench)
    for i in range(at.energy - at.contacts):  # the field that follows
        row[at.contacts + i] = contacts[i // 8, i % 8] if i < contacts.size else 0.0
    for i in range(row.size - at.memory):  # the last field
        row[at.memory + i] = memory[i] if i < memory.size else np.nan


# --------------------------------------------------------------------------------------------------
# Message on the cause of a trip.


def explain_trip(reason: Trip, cause: BaseException, world: World) -> str:
    """Error of the failed `world` or driver, with its place in user code."""
    if reason is Trip.MEMORY_NOT_FINITE:
        return str(cause)
    if reason is not Trip.WORLD_FAILED:
        return f"{type(cause).__name__}: {cause}"
    return describe_failure(world, cause)


# --------------------------------------------------------------------------------------------------
# Background thread that computes the work of a world while ticks continue.


@final
class WorkThread:
    """Thread for background work, one piece at a time, at ordinary priority and on other processors than the loop's.

    It starts with the first work and ends with the process; where no thread can start, the work is computed at once,
    and the tick is late. It holds the interpreter lock only between calls of the engine, for some 10 µs.

    done   whether the last submitted work has been computed
    took   its processor time [s]
    """

    def __init__(self) -> None:
        self._works: SimpleQueue[WorldWork] = SimpleQueue()
        self._thread: Thread | None = None
        self._result: Any = None
        self._fault: BaseException | None = None
        self.done, self.took = False, 0.0

    def submit(self, work: WorldWork) -> None:
        """Start computing `work`; the one before must be done."""
        self.done = False
        if self._thread is None:
            loops = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
            thread = Thread(target=self._run, args=(loops,), name="work of the world", daemon=True)
            try:
                thread.start()
            except RuntimeError:  # no memory, or too many threads
                self._compute(work)
                return
            self._thread = thread
        self._works.put(work)

    def collect(self) -> Any:
        """Return the result of the last work, which must be done. Raises what its computation raised."""
        if self._fault is not None:
            fault, self._fault = self._fault, None
            raise fault
        return self._result

    def _run(self, loops: set[int]) -> None:
        """Thread function. `loops`: processors of the loop, which this thread must not use, nor the loop's priority.
        Empty where the system does not report them."""
        if loops:
            others = {*range(os.cpu_count() or 1)} - loops
            with suppress(OSError):
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            with suppress(OSError):
                os.sched_setaffinity(0, others or loops)
        while True:
            self._compute(self._works.get())

    def _compute(self, work: WorldWork) -> None:
        start = thread_time()
        try:
            self._result = work.compute()
        except BaseException as fault:  # the tick that collects the result trips
            self._fault = fault
        self.took = thread_time() - start
        self.done = True


# --------------------------------------------------------------------------------------------------
# Computing time budget of a world with memory, and the reduction of its detail.


_MAX_SHARE = 0.4  #: average share of a tick that a world may take; the rest of the tick needs about 0.2 ms
_RESTORE_SHARE = 0.15  #: average share of a tick below which detail is restored
_AVERAGED_STEPS = 8.0  #: steps in the average
_MAX_COUNTED_TICKS = 2.0  #: cap on a single step in the average [ticks]: the computer may have interrupted it
_RESTORE_DELAY_S = 1.0  #: time with such an average before one level of detail is restored
_MAX_WAIT_FACTOR = 64.0  #: limit of the back-off of that time after restorations that had to be reverted
_MAX_LONG_STEPS = 1.9  #: decayed count of overruns at reduced detail above which it is reduced further: two
_DECAY_PER_TICK = 0.998  #: exponential forgetting factor of that count
_NOTHING = TickFailure(0)


class StepWatch(Protocol):
    """Receives the begin and end of each step of a world, and changes its detail."""

    def begin(self, bound: BoundWorld) -> None:
        """Begin a step of `bound`."""

    def end(self, bound: BoundWorld) -> TickFailure:
        """End the step of `bound`. Return LESS_DETAIL or MORE_DETAIL if its detail changed, and WORK if it began with
        the result of background work; else 0."""


@final
class WorldBudget:
    """Monitors the computing time of a world's steps in ticks of `dt` [s], and reduces or restores its detail.

    A step cannot be interrupted: the budget leaves more than half of a tick, so that a scene which takes longer reduces
    detail before ticks are late. If single steps are longer than a tick even so, a background thread computes
    them. Average processor time counts, not wall time: a step that is delayed by other work of the computer is not
    faster with less detail, and the change of the scene would be felt without need.
    """

    def __init__(self, dt: float) -> None:
        self._budget, self._easy, self._most = _MAX_SHARE * dt, _RESTORE_SHARE * dt, _MAX_COUNTED_TICKS * dt
        self._wait = round(_RESTORE_DELAY_S / dt)
        self._mean, self._calm, self._patience = 0.0, 0, 1.0
        self._start = self._background = 0.0  # processor time: start of the step, last background work [s]
        self._whole, self._long, self._lighter = dt, 0.0, 0
        self._thread, self._found = WorkThread(), _NOTHING
        self._work: WorldWork | None = None
        self._owner: BoundWorld | None = None

    @property
    def is_computing(self) -> bool:
        """Whether the background thread is computing."""
        return self._work is not None and not self._thread.done

    def begin(self, bound: BoundWorld) -> None:
        """Begin a step of `bound`, with the result of background work if that is due and done."""
        self._found = _NOTHING
        if self._work is not None and self._thread.done and not (bound.paused or bound.failed):
            if self._owner is not bound or not self._work.fits(bound.memory):  # another world, or restarted
                self._work = None
            elif bound.world.is_work_due(bound.memory):
                self._work, self._background = None, self._thread.took
                bound.world.take_over(bound.memory, self._thread.collect())
                self._found = TickFailure.WORK
        self._start = thread_time()

    def end(self, bound: BoundWorld) -> TickFailure:
        """End the step of `bound`, which began on this thread."""
        took = thread_time() - self._start
        if self._work is None:
            self._work = bound.world.find_work(bound.memory)
            if self._work is None:
                self._background = 0.0
            else:
                self._owner = bound
                self._thread.submit(self._work)
        return self.judge(bound, max(took, self._background)) | self._found

    def judge(self, bound: BoundWorld, took: float) -> TickFailure:
        """Change the detail of `bound` after a step that took so much processor time [s], if it must."""
        self._mean += (min(took, self._most) - self._mean) / _AVERAGED_STEPS
        self._long = _DECAY_PER_TICK * self._long + (self._lighter > 0 and took > self._whole and not self._background)
        if self._mean > self._budget or self._long >= _MAX_LONG_STEPS:
            self._mean, self._calm, self._long = 0.0, 0, 0.0
            before = bound.numbers.copy()
            bound.world.lighten(bound.memory)  # safety: overrun-sheds-detail
            if (bound.numbers == before).all():
                return _NOTHING
            self._lighter += 1
            self._patience = min(2.0 * self._patience, _MAX_WAIT_FACTOR)
            return TickFailure.LESS_DETAIL
        if self._mean > self._easy:
            self._calm = 0
            return _NOTHING
        self._calm += 1
        if self._calm < self._wait * self._patience:
            return _NOTHING
        self._calm = 0
        before = bound.numbers.copy()
        bound.world.restore(bound.memory)
        if (bound.numbers == before).all():
            return _NOTHING
        self._lighter -= 1
        return TickFailure.MORE_DETAIL


#: scalar fields that a tick fills itself; the first is the start of those of `fill_pose`
_SINGLE = (
    "current_age", "ahead", "world", "coil_state", "saturated", "part", "model", "mode", "engaged", "gripper",
    "gripper_v", "gripper_force",
)  # fmt: skip


class Tick(Stateful):
    """Control chain of one device, world and driver; `step` runs it once and fills one row.

    Any failure trips, coils off, with a reason; no exception leaves them on.
    """

    def __init__(
        self,
        device: Device,
        world: World,
        driver: Driver,
        estimator: Estimator,
        allocator: Allocator,
        dt: float,
        linkage: Linkage | None = None,
        *,
        choice: WrenchChoice | None = None,
    ) -> None:
        self.world = world.for_device(device)
        self._device, self._dt = device, dt
        check_world_period(self.world, dt)
        self.client = make_client_force()  #: (1,) command of a client program; the loop fills it
        self._session: Any = self.client["session"].data  # faster than unpacking the record in a kernel
        self._mapping: Any = self.client["mapping"].data
        self._bound = bind_world(self.world, dt, client=self.client)  # of a world with memory; None of another
        self.budget: StepWatch = WorldBudget(dt)
        self.world_changes = 0
        self.driver, self.estimator = driver, estimator
        self._log, self.linkage = TickLog(), linkage or Direct()
        self.joining = NotedLinkage(self.linkage, self._log)
        self.protection = Protection(device, dt, self.linkage.arm)
        self.protection.change_world(passive=self.world.passive and self.linkage.passive)
        gripper = find_gripper(device)
        self.gripper = None if gripper is None else GripperGuard(gripper, dt)
        self.layout = RowLayout.of(device)
        self._failure: tuple[Trip, BaseException] | None = None  # first one since the last engage
        self._zeros, self._duty_applied = np.zeros(device.channels), np.zeros(device.channels)
        self._nothing, self._no_memory = np.zeros(6), np.zeros(0)
        #: object in the last tick that rendered: share (2,), place (3,), R (3, 3) and contacts
        self._kept, self._kept_cells = make_block(
            {"applied": (device.channels,), "rendered": (6,), "on_thing": (6,),
             "thing": (14 + 8 * self.layout.contacts,)},
            counts=("world_changes", "model", "torque_scale", "mode", "engaged", "paused", "failed"),
        )  # fmt: skip
        self._object: Array = self._kept["thing"]
        self._object[5:14] = np.eye(3).ravel()
        self._object_mode, self._object_engaged = 0, False
        self._no_currents = Allocation(self._zeros, self._nothing, Saturation.NONE, 0.0)
        self._stages = np.zeros(len(STAGES))
        self._times: Any = self._stages.data  # scalar access through it is twice as fast
        self._ahead = 0.0  # duration of `prepare` [s]
        self._model = float(device.models.index(estimator.model)) if estimator.model else np.nan
        self._rendered: Array = self._kept["rendered"]
        self._object_wrench: Array = self._kept["on_thing"]
        self.part = RenderedPart(allocator, choice, self.protection, self._rendered)
        self.part.begin(self.world)
        self._places = self.layout.places
        # Bound once: dictionary look-ups in every tick take 0.25 µs for all of them.
        self._cells = tuple(self.layout[name].start for name in _SINGLE)
        commands, failures, scale = (self.layout[name].start for name in ("commands", "failures", "torque_scale"))
        self._log_places = commands, failures, scale

    @property
    def remark(self) -> str:
        """Warning of the estimator, to be displayed before use; empty if there is none."""
        return self.estimator.remark

    @property
    def error(self) -> str:
        """Error of a failed world or driver, with its place in user code; empty for other trips. Read it after the
        tick: composing it takes longer than switching the coils off."""
        return "" if self._failure is None else explain_trip(*self._failure, self.world)

    def change_world(self, world: World) -> None:
        """Render `world` from the next tick on: another kind of world when the wrench of this one has faded to zero,
        the same with other values without a step (`force_transitions.pass_over`).

        In another kind of world the object is reset; with other parameters it keeps its pose, and a world with memory
        keeps its memory according to its own rule.
        """
        self._go_over(world)
        self._log.record(TickCommand.WORLD)

    def _go_over(self, world: World, *, other: bool = False) -> None:
        fitted = world.for_device(self._device)
        check_world_period(fitted, self._dt)
        restarts = type(split_remote(fitted)[0]) is not type(split_remote(self.world)[0])
        # The position of an object that was reset differs from that in a memory.
        bound = bind_world(fitted, self._dt, None if restarts and self.linkage.modes else self._bound, self.client)
        if restarts:
            self.linkage.restart()
        self.world, self._bound = fitted, bound
        self.protection.change_world(passive=self.world.passive and self.linkage.passive, other=other or restarts)
        self.part.begin(fitted)
        self.world_changes += 1

    def replace_world(self, world: World) -> None:
        """Render another version of the world, when the wrench of this one has faded to zero."""
        self._go_over(world, other=True)
        self._log.record(TickCommand.REPLACE)

    def change_model(self, number: int) -> None:
        """Invert another of the device's models, counted from 0, without a step. InputError if the estimator cannot."""
        self.estimator.change_model(self._device.models[number])
        self._model = float(number)
        self._log.record_model(number)

    def stop(self) -> None:
        """Stop on a user's request: coils off until `engage`."""
        self._log.record(TickCommand.STOP)
        self.protection.trip(Trip.STOPPED)

    def engage(self) -> bool:
        """Leave OFF or a trip; return False while its reason persists. No effect while engaged."""
        if self.protection.engaged:
            return True
        self._log.record(TickCommand.ENGAGE)
        try:
            self.driver.engage()
        except HaptorbError as cause:
            self._log.fail(TickFailure.ENGAGE)
            self._fail(Trip.DRIVER_FAILED, cause)
            return False
        engaged = self.protection.engage()
        if engaged:
            self._failure = None
            if self._bound is not None and self._bound.failed:  # safety: failed-memory-restarts
                self._restart_memory(self._bound)
        return engaged

    def _restart_memory(self, bound: BoundWorld) -> None:
        try:
            bound.restart()
        except BaseException as cause:  # user code: also sys.exit
            self._fail(Trip.WORLD_FAILED, cause)

    def cool(self) -> None:
        """Set simulated coils and the guard's thermal model to the ambient temperature; no effect on a real device."""
        if self.driver.simulated:  # safety: cool-simulated
            self._log.record(TickCommand.COOL)
            self.driver.cool()
            self.protection.restart_heat()

    def exclude_next_lateness(self) -> None:
        """Exclude a late wake-up by the computer from the guard's limits on a simulated device; a real one may trip."""
        if self.driver.simulated:  # safety: excuse-simulated
            self._log.record(TickCommand.EXCUSE)
            self.protection.exclude_next_lateness()

    def prepare(self, now: float) -> None:
        """Let the driver do its work before the tick at `now` [s]."""
        t0 = perf_counter()
        # `read` raises it again, and then the tick trips.
        with suppress(HaptorbError):  # safety: preparing-ends-no-loop
            self.driver.prepare(now)
        self._ahead = perf_counter() - t0

    def load_allocation(self) -> None:
        """Load the code that allocates currents; before the first `step`."""
        with suppress(HaptorbError):
            self.part.allocator.allocate(WrenchMap(np.zeros((6, self._device.channels)), np.zeros(6)), np.zeros(6))

    def load_row(self, row: Array) -> None:
        """Load the code that fills `row` (width,), which has no meaning afterwards; before the first `step`."""
        still, turn, protection = np.zeros(3), np.eye(3), self.protection
        rendered, field = self._render_nothing(0.0), np.zeros((self._device.sensors, 3))
        body = rendered.object
        fill_row(
            row, self._places, protection.state, protection.coils, self.driver.hand_goal(), self.driver.wrench_actual(),
            self._duty_applied, field, self._stages,
        )  # fmt: skip
        fill_pose(row, self._cells[0], turn, still, still, still, 0.0, False, 0.0, 0.0)
        fill_object(
            row, self._places, rendered.share, body.p, body.R_SR, self._object_wrench, rendered.contacts,
            self._no_memory, self._object,
        )  # fmt: skip

    def step(self, row: Array, now: float) -> None:
        """Run the chain at `now` [s] and fill `row` (width,), all but tick, wall, lateness and missed."""
        times, protection = self._times, self.protection
        t0 = perf_counter()
        try:
            sample = self.driver.read(now)
        except HaptorbError as cause:
            self._log.fail(TickFailure.READ)
            self._fail(Trip.DRIVER_FAILED, cause)  # safety: driver-failure-trips
            self._switch_off(row, now)
            return
        t1 = perf_counter()
        estimate = self.estimator.update(sample)
        if estimate.valid:  # the first valid pose starts the ramp
            protection.start(estimate)
        t2 = perf_counter()
        rendered = self._render(estimate)
        t3 = perf_counter()
        # Modes scale the rendered wrench: the energy of an object's world is then not that of the hand.
        stored = np.nan if self._bound is None or self.linkage.modes else self._bound.energy
        asked = protection.protect_wrench(
            self._rendered, estimate, sample.t, stored, self._session[0], self._mapping[0]
        )  # fmt: skip
        allocation = self._allocate(estimate.wrench_map, asked)
        t4 = perf_counter()
        duty_commanded = protection.protect_currents(allocation.currents, estimate, sample, self._duty_applied)
        t5 = perf_counter()
        squeezed = np.nan
        try:
            self._duty_applied = self.driver.write(duty_commanded)
            if self.gripper is not None:
                wanted = 0.0 if self._bound is None else self._bound.gripper_force
                squeezed = self.driver.write_grip_force(self.gripper.limit(wanted, protection.gain, self._session[0]))
        except HaptorbError as cause:
            self._log.fail(TickFailure.WRITE)
            self._fail(Trip.DRIVER_FAILED, cause)
        t6 = perf_counter()
        times[0], times[1], times[2] = t1 - t0, t2 - t1, t3 - t2
        times[3], times[4], times[5] = t4 - t3, t5 - t4, t6 - t5
        (
            ages, ahead, world, coil_state, saturated, part, model, mode, engaged, gripper, gripper_v, gripper_force,
        ) = self._cells  # fmt: skip
        places, body, pose = self._places, rendered.object, sample.pose
        fill_row(
            row, places, protection.state, protection.coils, self.driver.hand_goal(), self.driver.wrench_actual(),
            self._duty_applied, sample.field, self._stages,
        )  # fmt: skip
        fill_pose(
            row, ages, pose.R_SR, pose.p, pose.v, pose.w, pose.t, pose.valid, sample.currents_age, sample.field_age
        )
        memory = self._no_memory if self._bound is None else self._bound.numbers
        fill_object(
            row, places, rendered.share, body.p, body.R_SR, self._object_wrench, rendered.contacts, memory, self._object
        )
        self._object_mode, self._object_engaged = rendered.mode, rendered.engaged
        cells: Any = row.data  # fast scalar access, as above
        cells[ahead], cells[world], cells[coil_state] = self._ahead, self.world_changes, self.driver.coil_state
        cells[saturated], cells[part], cells[model] = allocation.saturated, self.part.number, self._model
        cells[mode], cells[engaged] = rendered.mode, rendered.engaged
        cells[gripper], cells[gripper_v], cells[gripper_force] = sample.gripper, sample.gripper_velocity, squeezed
        self._log.fill(cells, self._log_places)
        times[6] = perf_counter() - t6

    def _render(self, estimate: Estimate) -> RenderedWrench:
        bound, commanded = self._bound, self.protection.commanded
        commanded.fill(0.0)  # three times faster than [:]
        try:
            if bound is None:
                rendered = self.linkage.render(self.world, estimate.state)
            else:
                bound.paused = not estimate.valid  # safety: memory-stands-still
                self.budget.begin(bound)
                rendered = self.linkage.render(bound, estimate.state)
                self._log.fail(self.budget.end(bound))
            check_wrench(rendered.wrench)
            # Copied: a user's array in another memory layout would cause a compilation in the middle of a tick.
            self._rendered[...], self._object_wrench[...] = rendered.wrench, rendered.object_wrench
            if bound is not None and bound.takes_commands:
                self.linkage.fill_mover_wrench(bound.commanded, commanded)
            if self.part.is_open:
                self.part.follow()
            return rendered
        except TickTimeout:
            raise
        # A world is user code: any exception must switch the coils off.
        except BaseException as cause:  # safety: world-exit-trips
            reason = Trip.MEMORY_NOT_FINITE if isinstance(cause, MemoryNotFinite) else Trip.WORLD_FAILED
            self._log.fail(TickFailure.MEMORY if reason is Trip.MEMORY_NOT_FINITE else TickFailure.WORLD)
            self._fail(reason, cause)  # safety: world-failure-trips
            self._rendered[:] = self._object_wrench[:] = commanded[:] = 0.0
            return self._render_nothing(estimate.state.t)

    def _render_nothing(self, t: float) -> RenderedWrench:
        """Render no wrench at `t` [s], with the last object."""
        held, still = self._object.copy(), np.zeros(3)
        body = State(t, held[5:14].reshape(3, 3), held[2:5], still, still)
        return RenderedWrench(
            self._nothing, body, self._nothing, held[14:].reshape(-1, 8), self._object_mode, held[:2],
            self._object_engaged,
        )  # fmt: skip

    def state_arrays(self) -> Mapping[str, StateArray]:
        """State: last applied duties and rendered wrench [1, N, N·m]; share, place [m], rotation and contacts of the
        object; counts and choices. The world's own memory is in the row."""
        return self._kept

    def state_parts(self) -> Mapping[str, Stateful]:
        """All stateful parts of the chain, in the order in which they are restored."""
        parts = {
            "protection": self.protection, "part": self.part, "linkage": self.linkage,
            "estimator": self.estimator,
        }  # fmt: skip
        return parts if self.gripper is None else {**parts, "gripper": self.gripper}

    def gather_state(self) -> None:
        """Copy the scalar state to its arrays."""
        self._kept["applied"][:] = self._duty_applied
        cells, bound = self._kept_cells, self._bound
        cells[0], cells[1], cells[2] = self.world_changes, self._model, self._log.scale
        cells[3], cells[4] = self._object_mode, self._object_engaged
        cells[5], cells[6] = (0.0, 0.0) if bound is None else (bound.paused, bound.failed)

    def apply_state(self) -> None:
        """Restore the scalar state from its arrays."""
        self._duty_applied = self._kept["applied"].copy()
        changes, self._model, scale, mode, engaged, paused, failed = self._kept_cells
        self.world_changes, self._object_mode = choose(changes, 1 << 53), choose(mode, 1 + len(MODES))
        self._log.scale, self._object_engaged = scale, bool(engaged)
        if self._bound is not None:
            self._bound.paused, self._bound.failed = bool(paused), bool(failed)

    def load_memory(self, memory: Array) -> None:
        """Restore the world's `memory` (n,), as in a row, in the units of its fields."""
        if self._bound is not None:
            self._bound.numbers[:] = memory[: self._bound.numbers.size]

    def _allocate(self, wrench_map: WrenchMap, wrench: Array) -> Allocation:
        try:
            return self.part.allocator.allocate(wrench_map, wrench)
        except HaptorbError as cause:
            self._log.fail(TickFailure.ALLOCATION)
            self._fail(Trip.CURRENTS_NOT_FINITE, cause)  # safety: allocation-failure-trips
            return self._no_currents

    def _fail(self, reason: Trip, cause: BaseException) -> None:
        if not self.protection.tripped:
            self._failure = (reason, cause)
        self.protection.trip(reason)

    def _switch_off(self, row: Array, now: float) -> None:
        """Switch off when the device does not respond, and record that in the row."""
        try:
            self._duty_applied = self.driver.write(self._zeros)
            if self.gripper is not None:  # safety: gripper-off-in-silence
                self.driver.write_grip_force(self.gripper.limit(0.0, 0.0, 0.0))
        except HaptorbError:
            self._log.fail(TickFailure.WRITE)
            self._duty_applied = self._zeros
        self.protection.skip_tick(now)
        fill_silent_row(row, self.layout, self.protection, self.driver.coil_state, now)
        row[self.layout["world"]], row[self.layout["duty_applied"]] = self.world_changes, self._duty_applied
        self._log.fill(row.data, self._log_places)


# --------------------------------------------------------------------------------------------------
# The interface of the chain that the loop uses.


class Joining(Protocol):
    """Commands of the loop to the linkage, which are recorded."""

    def set_mode(self, mode: Mode) -> None:
        """Change to `mode` without a step."""

    def set_clutch(self, engaged: bool) -> None:
        """Engage or release the clutch to the world's object, without a step."""

    def set_torque_scale(self, scale: float) -> None:
        """Scale the torques by `scale`, without a step."""


class Chain(Protocol):
    """Everything that one control cycle needs: driver, estimator, world, allocator, guard. Implemented by `Tick`."""

    @property
    def error(self) -> str:
        """Error of a failed world or driver, with its place in user code; empty for other trips."""

    @property
    def remark(self) -> str:
        """Warning of the estimator, to be displayed before use; empty if there is none."""

    @property
    def client(self) -> Records:
        """(1,) CLIENT_FORCE [N, s]: the command of a client program; the loop fills it before every step."""

    @property
    def driver(self) -> Driver:
        """The device driver."""

    @property
    def joining(self) -> Joining:
        """The linkage between the mover and the world's object."""

    def exclude_next_lateness(self) -> None:
        """Report that the next step is late because of a late wake-up, not because a step took too long."""

    def prepare(self, now: float) -> None:
        """Do the work for the tick at `now` [s] that need not wait for its deadline."""

    def step(self, row: Array, now: float) -> None:
        """Run one tick at `now` [s] on the loop's clock; fill all of `row` (width,) except the clock's fields, each
        number in the unit of its field."""

    def stop(self) -> None:
        """Stop on a user's request: coils off from the next step until `engage`."""

    def engage(self) -> bool:
        """Engage after a stop or a trip, from zero force; return False while the reason persists."""

    def cool(self) -> None:
        """Set simulated coils to the ambient temperature in the next step; no effect on a real device."""

    def change_model(self, number: int) -> None:
        """Invert another of the device's models, counted from 0, from the next step on; the force changes smoothly.
        Raises InputError if the estimator cannot."""

    def replace_world(self, world: World) -> None:
        """Render another version of the world from the next step on, as `change_world`, without a step of the force."""

    def change_world(self, world: World) -> None:
        """Render `world` from the next step on. Raises InputError if the device cannot."""


def render_world(chain: Chain, world: World, before: World) -> None:
    """Let `chain` render `world` after `before`: another function, sum or scene of the same class passes through zero,
    as another class does, and other values of the same world do not."""
    new, old = split_remote(world)[0], split_remote(before)[0]
    other = type(new) is type(old) and is_other_world(new, old)  # safety: another-of-a-class
    (chain.replace_world if other else chain.change_world)(world)


# --------------------------------------------------------------------------------------------------
# One tick of the loop: read, estimate, world, allocate, guard, write; and the row that it fills.


load_compiler()  # at import, so that no tick waits for it
