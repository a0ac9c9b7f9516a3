"""One tick of the loop: read → estimate → world → allocate → guard → write, and the row that tells it all.

The same seven lines run every device, simulated or real; nothing in them asks which one it is.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from haptorb.control.allocation.allocator import Allocation, Allocator
from haptorb.control.clutch.linkage import NO_CONTACTS, Direct, Felt, Linkage
from haptorb.control.protection.drive import Drive
from haptorb.control.protection.guard import Guard
from haptorb.control.protection.guard_rules import STATE
from haptorb.control.protection.passivity import PassivityControl
from haptorb.control.protection.trip import GuardState, Trip
from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap
from haptorb.errors import HaptorbError, InputError
from haptorb.numerics.arrays import Array
from haptorb.runtime.drivers.driver import Driver
from haptorb.runtime.realtime.tick_timeout import Hang
from haptorb.runtime.row import STAGES, RowLayout
from haptorb.runtime.tick.fill_row import places, tell
from haptorb.runtime.tick.kernels import asked, driven
from haptorb.sensing.estimator import Estimator
from haptorb.worlds.world import World

__all__ = ["Tick"]


class Tick:
    """The chain for one device, world and driver; `step` runs it once and fills one row.

    Whatever fails in it ends in coils off with a reason, never in an exception that leaves them on.
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
    ) -> None:
        self.world = world.for_device(device)
        self.world_changes = 0
        self.driver = driver
        self.estimator = estimator
        self.allocator = allocator
        self.linkage = linkage or Direct()
        self.guard = Guard(device, dt)
        self.drive = Drive(device, dt)
        self.passivity = PassivityControl(dt, self.linkage.arm, self.drive.lag)
        self._passive = self.world.passive and self.linkage.passive
        self.layout = RowLayout.of(device)
        self.error = ""  #: what a failed world or driver said
        self._device = device
        self._zeros = np.zeros(device.channels)
        self._applied = np.zeros(device.channels)
        self._nothing = np.zeros(6)
        nowhere = State(0.0, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))
        self._felt_last = Felt(self._nothing, nowhere, self._nothing, NO_CONTACTS, 0, np.zeros(2), False)
        self._no_currents = Allocation(self._zeros, self._nothing, False, 0.0)
        self._stages = np.zeros(len(STAGES))
        self._ahead = 0.0  # spent in `prepare` [s]
        self._admitted = np.zeros(6)
        self._rendered, self._on_thing = np.zeros(6), np.zeros(6)
        self._places = places(self.layout)
        layout = self.layout
        self._at = {field.name: layout[field.name] for field in layout.fields}
        self._one = {field.name: layout[field.name].start for field in layout.fields if field.width == 1}

    def change_world(self, world: World) -> None:
        """Render `world` from the next tick on; the guard's slew limit takes the step out of the change.

        In another kind of world the object begins anew; with other parameters it stays where it is.
        """
        fitted = world.for_device(self._device)
        if type(fitted) is not type(self.world):
            self.linkage.restart()
        self.world = fitted
        self._passive = fitted.passive and self.linkage.passive
        self.passivity.restart()
        self.world_changes += 1

    def stop(self) -> None:
        """A person stopped: coils off, and off until a person engages."""
        self.guard.trip(Trip.STOPPED)

    def engage(self) -> bool:
        """Leave OFF or a trip deliberately; False while its reason is still there. Nothing happens while engaged."""
        if self.guard.engaged:
            return True
        try:
            self.driver.engage()
        except HaptorbError as cause:
            self._failed(Trip.DRIVER_FAILED, cause)
            return False
        engaged = self.guard.engage()
        if engaged:
            self.error = ""
        return engaged

    def prepare(self, now: float) -> None:
        """Let the driver do what it can before the tick at `now` [s]."""
        t0 = perf_counter()
        with suppress(HaptorbError):  # `read` will say it again, and there it has consequences
            self.driver.prepare(now)
        self._ahead = perf_counter() - t0

    def step(self, row: Array, now: float) -> None:
        """Run the chain at `now` [s] and fill `row` (width,), all but tick, wall, lateness and missed."""
        stages, guard = self._stages, self.guard
        t0 = perf_counter()
        try:
            sample = self.driver.read(now)
        except HaptorbError as cause:
            self._failed(Trip.DRIVER_FAILED, cause)
            self._off(row, now)
            return
        t1 = perf_counter()
        estimate = self.estimator.update(sample)
        # The first valid pose starts the ramp. Whatever stopped before it, or after it, only a person clears.
        if estimate.valid and guard.numbers[STATE] == GuardState.OFF:
            guard.admit(self._nothing, estimate)
            guard.engage()
        t2 = perf_counter()
        felt = self._felt(estimate.state)
        t3 = perf_counter()
        state, matrix, heat, drive = estimate.state, estimate.wrench_map.matrix, guard.heat, self.drive
        asked(
            self.passivity.memory, guard.numbers, guard.coils, guard.clock, self._rendered, state.p, state.R_SR,
            sample.t, estimate.age, self._passive, estimate.valid, estimate.reversed, self._admitted,
        )  # fmt: skip
        allocation = self._allocated(estimate.wrench_map, self._admitted)
        t4 = perf_counter()
        driven(
            guard.numbers, guard.coils, guard.clock, heat.numbers, heat.coils, guard.check.coils, drive.numbers,
            drive.coils, allocation.currents, sample.currents, sample.currents_age, sample.temperatures,
            self._applied, matrix, state.v, state.w,
        )  # fmt: skip
        t5 = perf_counter()
        try:
            self._applied = self.driver.write(drive.chosen)
        except HaptorbError as cause:
            self._failed(Trip.DRIVER_FAILED, cause)
        t6 = perf_counter()
        stages[0], stages[1], stages[2], stages[3], stages[4], stages[5] = (
            t1 - t0, t2 - t1, t3 - t2, t4 - t3, t5 - t4, t6 - t5,
        )  # fmt: skip
        one, thing = self._one, felt.thing
        tell(
            row, self._places, state.p, state.R_SR, state.v, state.w, self.driver.target(),
            self._admitted, matrix, self.driver.truth(), guard.currents, sample.currents, self._applied,
            drive.resistance, sample.temperatures, heat.winding, sample.field, felt.share, thing.p,
            thing.R_SR, self._on_thing, felt.contacts, stages, guard.numbers, heat.numbers, self.passivity.numbers,
        )  # fmt: skip
        cells: Any = row.data  # single numbers go through it three times faster than into an array
        cells[one["t"]] = sample.t
        cells[one["ahead"]] = self._ahead
        cells[one["world"]] = self.world_changes
        cells[one["coil_state"]] = self.driver.coil_state
        cells[one["valid"]] = estimate.valid
        cells[one["age"]] = estimate.age
        cells[one["saturated"]] = allocation.saturated
        cells[one["mode"]] = felt.mode
        cells[one["engaged"]] = felt.engaged
        stages[6] = perf_counter() - t6

    def _felt(self, state: State) -> Felt:
        try:
            felt = self.linkage.felt(self.world, state)
            if felt.wrench.shape != (6,):
                raise InputError(f"a world must give force and torque, shape (6,); got shape {felt.wrench.shape}")
            # Copied: in another memory layout a user's array would have the kernels compiled in the middle of a tick.
            self._rendered[:], self._on_thing[:] = felt.wrench, felt.on_thing
            self._felt_last = felt
            return felt
        except Hang:
            raise
        except BaseException as cause:  # a world is the user's code: whatever it raises must end in coils off
            self._failed(Trip.WORLD_FAILED, cause)
            self._rendered[:] = self._on_thing[:] = 0.0
            return replace(self._felt_last, wrench=self._nothing, on_thing=self._nothing)

    def _allocated(self, wrench_map: WrenchMap, wrench: Array) -> Allocation:
        try:
            return self.allocator.allocate(wrench_map, wrench)
        except HaptorbError as cause:
            self._failed(Trip.CURRENTS_NOT_FINITE, cause)
            return self._no_currents

    def _failed(self, reason: Trip, cause: BaseException) -> None:
        if not self.guard.tripped:
            leaves = isinstance(cause, SystemExit)
            self.error = f"the world called sys.exit({cause})" if leaves else f"{type(cause).__name__}: {cause}"
        self.guard.trip(reason)

    def _off(self, row: Array, now: float) -> None:
        """What is left to do when the device does not answer: try to switch off, and say so in the row."""
        try:
            self._applied = self.driver.write(self._zeros)
        except HaptorbError:
            self._applied = self._zeros
        self.guard.skip(now)
        row[:] = np.nan
        row[self._one["t"]] = now
        row[self._one["guard"]] = self.guard.state
        row[self._one["trip"]] = self.guard.reason
        row[self._one["coil_state"]] = self.driver.coil_state
        row[self._one["gain"]] = 0.0
        row[self._one["world"]] = self.world_changes
        row[self._one["valid"]] = 0.0
        row[self._at["wanted"]] = 0.0
        row[self._at["duties"]] = self._applied
