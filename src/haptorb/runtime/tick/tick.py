"""One tick of the loop: read → estimate → world → allocate → guard → write, and the row that records it all.

The same seven lines run every device, simulated or real; nothing in them asks which one it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from time import perf_counter
from typing import Any

import numpy as np

from haptorb.control.allocation.allocator import Allocation, Allocator, Saturation
from haptorb.control.allocation.wrench_choice import WrenchChoice
from haptorb.control.clutch.linkage import Direct, Linkage, RenderedWrench
from haptorb.control.clutch.modes import MODES
from haptorb.control.protection.protection import Protection
from haptorb.control.protection.trip import Trip
from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap
from haptorb.errors import HaptorbError
from haptorb.numerics.arrays import Array
from haptorb.numerics.state_arrays import StateArray, Stateful, choose, make_block
from haptorb.runtime.drivers.driver import Driver
from haptorb.runtime.realtime.tick_timeout import TickTimeout
from haptorb.runtime.row import STAGES, RowLayout
from haptorb.runtime.tick.fill_row import fill_object, fill_pose, fill_row
from haptorb.runtime.tick.rendered_part import RenderedPart
from haptorb.runtime.tick.silent_row import fill_silent_row
from haptorb.runtime.tick.tick_log import NotedLinkage, TickCommand, TickFailure, TickLog
from haptorb.runtime.tick.trip_cause import explain_trip
from haptorb.runtime.tick.world_budget import StepWatch, WorldBudget
from haptorb.sensing.estimator import Estimator
from haptorb.sensing.sample import Estimate
from haptorb.worlds.bound_world import BoundWorld, MemoryNotFinite, bind_world, check_world_period
from haptorb.worlds.client_force import make_client_force
from haptorb.worlds.dynamic.remote_sum import split_remote
from haptorb.worlds.own.failure import check_wrench
from haptorb.worlds.world import World

__all__ = ["Tick"]

#: fields of one number each that a tick fills itself; the first begins those of `fill_pose`
_SINGLE = ("currents_age", "ahead", "world", "coil_state", "saturated", "part", "model", "mode", "engaged")


class Tick(Stateful):
    """The chain for one device, world and driver; `step` runs it once and fills one row.

    Any failure in it ends in coils off with a reason, never in an exception that leaves them on.
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
        self.client = make_client_force()  #: (1,) what a program outside the loop commands; the loop fills it
        self._bound = bind_world(self.world, dt, client=self.client)  # of a world with memory; None of another
        self.budget: StepWatch = WorldBudget(dt)
        self.world_changes = 0
        self.driver, self.estimator = driver, estimator
        self._log, self.linkage = TickLog(), linkage or Direct()
        self.joining = NotedLinkage(self.linkage, self._log)
        self.protection = Protection(device, dt, self.linkage.arm)
        self.protection.change_world(passive=self.world.passive and self.linkage.passive)
        self.layout = RowLayout.of(device)
        self._failure: tuple[Trip, BaseException] | None = None  # since the last engage
        self._zeros, self._applied = np.zeros(device.channels), np.zeros(device.channels)
        self._nothing, self._no_memory = np.zeros(6), np.zeros(0)
        #: what the world acted on in the last tick that rendered: share (2,), place (3,), R (3, 3) and contacts
        self._kept, self._kept_cells = make_block(
            {"applied": (device.channels,), "rendered": (6,), "on_thing": (6,),
             "thing": (14 + 8 * self.layout.contacts,)},
            counts=("world_changes", "model", "torque_scale", "mode", "engaged", "paused", "failed"),
        )  # fmt: skip
        self._held: Array = self._kept["thing"]
        self._held[5:14] = np.eye(3).ravel()
        self._held_mode, self._held_engaged = 0, False
        self._no_currents = Allocation(self._zeros, self._nothing, Saturation.NONE, 0.0)
        self._stages = np.zeros(len(STAGES))
        self._times: Any = self._stages.data  # single numbers go through it twice as fast
        self._ahead = 0.0  # spent in `prepare` [s]
        self._model = float(device.models.index(estimator.model)) if estimator.model else np.nan
        self._rendered: Array = self._kept["rendered"]
        self._on_thing: Array = self._kept["on_thing"]
        self.part = RenderedPart(allocator, choice, self.protection, self._rendered)
        self.part.begin(self.world)
        self._places = self.layout.places
        # Looked up once: a dictionary in every tick takes a quarter of a microsecond for all of them.
        self._cells = tuple(self.layout[name].start for name in _SINGLE)
        commands, failures, scale = (self.layout[name].start for name in ("commands", "failures", "torque_scale"))
        self._log_places = commands, failures, scale

    @property
    def remark(self) -> str:
        """What a person should know of the estimator before it is relied on; empty for nothing."""
        return self.estimator.remark

    @property
    def error(self) -> str:
        """What a failed world or driver said, and where in a user's code; empty for other trips. Read it after the
        tick: to say it takes longer than to switch the coils off."""
        return "" if self._failure is None else explain_trip(*self._failure, self.world)

    def change_world(self, world: World) -> None:
        """Render `world` from the next tick on: another kind of world when the wrench of this one has faded to zero,
        the same with other values without a step (`guard.pass_over`).

        In another kind of world the object is reset; with other parameters it stays where it is, and a world with
        memory keeps of it what its rule says.
        """
        self._go_over(world)
        self._log.note(TickCommand.WORLD)

    def _go_over(self, world: World, *, other: bool = False) -> None:
        fitted = world.for_device(self._device)
        check_world_period(fitted, self._dt)
        restarts = type(split_remote(fitted)[0]) is not type(split_remote(self.world)[0])
        # A target that was reset is not where a memory has it.
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
        self._log.note(TickCommand.REPLACE)

    def change_model(self, number: int) -> None:
        """Invert another of the device's models, counted from 0, without a step. InputError if the estimator cannot."""
        self.estimator.change_model(self._device.models[number])
        self._model = float(number)
        self._log.note_model(number)

    def stop(self) -> None:
        """A person stopped: coils off, and off until a person engages."""
        self._log.note(TickCommand.STOP)
        self.protection.trip(Trip.STOPPED)

    def engage(self) -> bool:
        """Leave OFF or a trip deliberately; False while its reason is still there. Nothing happens while engaged."""
        if self.protection.engaged:
            return True
        self._log.note(TickCommand.ENGAGE)
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
        except BaseException as cause:  # the user's code: also sys.exit
            self._fail(Trip.WORLD_FAILED, cause)

    def cool(self) -> None:
        """Simulated coils at the ambient temperature. Real ones stay as warm as they are, and as the guard knows."""
        if self.driver.simulated:  # safety: cool-simulated
            self._log.note(TickCommand.COOL)
            self.driver.cool()
            self.protection.restart_heat()

    def excuse_lateness(self) -> None:
        """The computer woke the loop too late. A simulated device does not trip for that; a real one may."""
        if self.driver.simulated:  # safety: excuse-simulated
            self._log.note(TickCommand.EXCUSE)
            self.protection.excuse_lateness()

    def prepare(self, now: float) -> None:
        """Let the driver do what it can before the tick at `now` [s]."""
        t0 = perf_counter()
        # `read` will say it again, and there it has consequences.
        with suppress(HaptorbError):  # safety: preparing-ends-no-loop
            self.driver.prepare(now)
        self._ahead = perf_counter() - t0

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
        # Modes scale what the hand feels: what a target's world holds is no measure of it.
        stored = np.nan if self._bound is None or self.linkage.modes else self._bound.energy
        asked = protection.protect_wrench(self._rendered, estimate, sample.t, stored, self.client)
        allocation = self._allocate(estimate.wrench_map, asked)
        t4 = perf_counter()
        duties = protection.protect_currents(allocation.currents, estimate, sample, self._applied)
        t5 = perf_counter()
        try:
            self._applied = self.driver.write(duties)
        except HaptorbError as cause:
            self._log.fail(TickFailure.WRITE)
            self._fail(Trip.DRIVER_FAILED, cause)
        t6 = perf_counter()
        times[0], times[1], times[2] = t1 - t0, t2 - t1, t3 - t2
        times[3], times[4], times[5] = t4 - t3, t5 - t4, t6 - t5
        ages, ahead, world, coil_state, saturated, part, model, mode, engaged = self._cells
        places, thing, pose = self._places, rendered.thing, sample.pose
        fill_row(
            row, places, protection.state, protection.coils, self.driver.target(), self.driver.truth(), self._applied,
            sample.field, self._stages,
        )  # fmt: skip
        fill_pose(
            row, ages, pose.R_SR, pose.p, pose.v, pose.w, pose.t, pose.valid, sample.currents_age, sample.field_age
        )
        memory = self._no_memory if self._bound is None else self._bound.numbers
        fill_object(
            row, places, rendered.share, thing.p, thing.R_SR, self._on_thing, rendered.contacts, memory, self._held
        )
        self._held_mode, self._held_engaged = rendered.mode, rendered.engaged
        cells: Any = row.data  # single numbers, as above
        cells[ahead], cells[world], cells[coil_state] = self._ahead, self.world_changes, self.driver.coil_state
        cells[saturated], cells[part], cells[model] = allocation.saturated, self.part.number, self._model
        cells[mode], cells[engaged] = rendered.mode, rendered.engaged
        self._log.fill(cells, self._log_places)
        times[6] = perf_counter() - t6

    def _render(self, estimate: Estimate) -> RenderedWrench:
        bound, commanded = self._bound, self.protection.commanded
        commanded[:] = 0.0
        try:
            if bound is None:
                rendered = self.linkage.render(self.world, estimate.state)
            else:
                bound.paused = not estimate.valid  # safety: memory-stands-still
                self.budget.begin(bound)
                rendered = self.linkage.render(bound, estimate.state)
                self._log.fail(self.budget.end(bound))
            check_wrench(rendered.wrench)
            # Copied: in another memory layout a user's array would have the kernels compiled in the middle of a tick.
            self._rendered[:], self._on_thing[:] = rendered.wrench, rendered.on_thing
            if bound is not None and bound.takes_commands:
                self.linkage.bring_back(bound.commanded, commanded)
            if self.part.is_open:
                self.part.follow()
            return rendered
        except TickTimeout:
            raise
        # A world is the user's code: any exception must end in coils off.
        except BaseException as cause:  # safety: world-exit-trips
            reason = Trip.MEMORY_NOT_FINITE if isinstance(cause, MemoryNotFinite) else Trip.WORLD_FAILED
            self._log.fail(TickFailure.MEMORY if reason is Trip.MEMORY_NOT_FINITE else TickFailure.WORLD)
            self._fail(reason, cause)  # safety: world-failure-trips
            self._rendered[:] = self._on_thing[:] = commanded[:] = 0.0
            return self._render_nothing(estimate.state.t)

    def _render_nothing(self, t: float) -> RenderedWrench:
        """No wrench at `t` [s], on what the world acted on last."""
        held, still = self._held.copy(), np.zeros(3)
        thing = State(t, held[5:14].reshape(3, 3), held[2:5], still, still)
        return RenderedWrench(
            self._nothing, thing, self._nothing, held[14:].reshape(-1, 8), self._held_mode, held[:2],
            self._held_engaged,
        )  # fmt: skip

    def state_arrays(self) -> Mapping[str, StateArray]:
        """What was applied and rendered last [1, N, N·m]; share, place [m], rotation and contacts of what the world
        acted on; counts and choices. The world's own memory is in the row."""
        return self._kept

    def state_parts(self) -> Mapping[str, Stateful]:
        """All parts of the chain that remember something, in the order in which they are taken over."""
        return {
            "protection": self.protection, "part": self.part, "linkage": self.linkage,
            "estimator": self.estimator,
        }  # fmt: skip

    def gather_state(self) -> None:
        """Copy what it holds itself."""
        self._kept["applied"][:] = self._applied
        cells, bound = self._kept_cells, self._bound
        cells[0], cells[1], cells[2] = self.world_changes, self._model, self._log.scale
        cells[3], cells[4] = self._held_mode, self._held_engaged
        cells[5], cells[6] = (0.0, 0.0) if bound is None else (bound.paused, bound.failed)

    def apply_state(self) -> None:
        """Take it over."""
        self._applied = self._kept["applied"].copy()
        changes, self._model, scale, mode, engaged, paused, failed = self._kept_cells
        self.world_changes, self._held_mode = choose(changes, 1 << 53), choose(mode, 1 + len(MODES))
        self._log.scale, self._held_engaged = scale, bool(engaged)
        if self._bound is not None:
            self._bound.paused, self._bound.failed = bool(paused), bool(failed)

    def take_memory(self, memory: Array) -> None:
        """Let the world remember `memory` (n,), as a row has it, in the units of its fields."""
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
        """When the device does not respond: try to switch off, and record it in the row."""
        try:
            self._applied = self.driver.write(self._zeros)
        except HaptorbError:
            self._log.fail(TickFailure.WRITE)
            self._applied = self._zeros
        self.protection.skip_tick(now)
        fill_silent_row(row, self.layout, self.protection, self.driver.coil_state, now)
        row[self.layout["world"]], row[self.layout["duties"]] = self.world_changes, self._applied
        self._log.fill(row.data, self._log_places)
