"""One tick of the loop: read → estimate → world → allocate → guard → write, and the row that tells it all.

The same seven lines run every device, simulated or real; nothing in them asks which one it is.
"""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np

from haptorb.control.allocator import Allocation, Allocator
from haptorb.control.drive import Drive
from haptorb.control.guard import Guard
from haptorb.control.linkage import NO_CONTACTS, Direct, Felt, Linkage
from haptorb.control.trip import Trip
from haptorb.devices.device import Device
from haptorb.devices.state import State
from haptorb.devices.wrench_map import WrenchMap
from haptorb.errors import HaptorbError, InputError
from haptorb.physics.arrays import Array
from haptorb.physics.compiled import kernel
from haptorb.runtime.driver import Driver
from haptorb.runtime.row import STAGES, RowLayout
from haptorb.sensing.estimator import Estimator
from haptorb.worlds.world import World

__all__ = ["Tick"]


@kernel
def _quaternion(R: Array, q: Array) -> None:
    """The quaternion (x, y, z, w) of a rotation matrix, by the largest of the four candidates (Shepperd's method)."""
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
        layout = self.layout
        self._at = {field.name: layout[field.name] for field in layout.fields}
        self._one = {field.name: layout[field.name].start for field in layout.fields if field.width == 1}
        self._wants_engagement = True

    def change_world(self, world: World) -> None:
        """Render `world` from the next tick on; the guard's slew limit takes the step out of the change.

        In another kind of world the object begins anew; with other parameters it stays where it is.
        """
        fitted = world.for_device(self._device)
        if type(fitted) is not type(self.world):
            self.linkage.restart()
        self.world = fitted
        self.world_changes += 1

    def engage(self) -> bool:
        """Leave OFF or a trip deliberately; False while its reason is still there."""
        try:
            self.driver.engage()
        except HaptorbError as cause:
            self._failed(Trip.DRIVER_FAILED, cause)
            return False
        engaged = self.guard.engage()
        if engaged:
            self.error = ""
        return engaged

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
        if self._wants_engagement and estimate.valid:  # the first belief starts the ramp; after that only people do
            guard.admit(self._nothing, estimate)
            self._wants_engagement = not guard.engage()
        t2 = perf_counter()
        felt = self._felt(estimate.state)
        t3 = perf_counter()
        admitted = guard.admit(felt.wrench, estimate)
        allocation = self._allocated(estimate.wrench_map, admitted)
        t4 = perf_counter()
        currents = guard.limit(allocation.currents, sample)
        t5 = perf_counter()
        if guard.gain:
            # What the coils push against: the power that they give to the mover, per ampere.
            moving = np.concatenate((estimate.state.v, estimate.state.w))
            emf = moving @ estimate.wrench_map.matrix
            duties = self.drive.duties(currents, sample.currents, self._applied, emf)
        else:
            duties = self.drive.rest()
        try:
            self._applied = self.driver.write(duties)
        except HaptorbError as cause:
            self._failed(Trip.DRIVER_FAILED, cause)
        t6 = perf_counter()
        stages[0], stages[1], stages[2], stages[3], stages[4], stages[5] = (
            t1 - t0, t2 - t1, t3 - t2, t4 - t3, t5 - t4, t6 - t5,
        )  # fmt: skip
        at, one, state = self._at, self._one, estimate.state
        row[one["t"]] = sample.t
        row[at["stages"]] = stages
        row[one["guard"]] = guard.state
        row[one["trip"]] = guard.reason
        row[one["gain"]] = guard.gain
        row[one["world"]] = self.world_changes
        row[one["valid"]] = estimate.valid
        row[one["age"]] = estimate.age
        row[at["p"]] = state.p
        _quaternion(state.R_SR, row[at["q"]])
        row[at["v"]] = state.v
        row[at["w"]] = state.w
        target = self.driver.target()
        row[at["target"]] = target[:3]
        row[at["target_q"]] = target[3:]
        row[at["asked"]] = admitted
        row[at["modelled"]] = estimate.wrench_map.matrix @ sample.currents
        row[at["given"]] = self.driver.truth()
        row[at["wanted"]] = currents
        row[at["currents"]] = sample.currents
        row[at["duties"]] = self._applied
        row[at["resistance"]] = self.drive.resistance
        row[at["boundary"]] = sample.temperatures
        row[at["winding"]] = guard.heat.winding
        row[one["remaining"]] = guard.heat.remaining
        row[one["saturated"]] = allocation.saturated
        row[at["field"]] = sample.field.ravel()
        row[one["mode"]] = felt.mode
        row[one["engaged"]] = felt.engaged
        row[at["share"]] = felt.share
        row[at["object"]] = felt.thing.p
        _quaternion(felt.thing.R_SR, row[at["object_q"]])
        row[at["object_wrench"]] = felt.on_thing
        row[at["contacts"]] = felt.contacts.ravel()
        stages[6] = perf_counter() - t6

    def _felt(self, state: State) -> Felt:
        try:
            felt = self.linkage.felt(self.world, state)
            if felt.wrench.shape != (6,):
                raise InputError(f"a world must give force and torque, shape (6,); got shape {felt.wrench.shape}")
            self._felt_last = felt
            return felt
        except Exception as cause:  # a world is the user's code: whatever it raises must end in coils off
            self._failed(Trip.WORLD_FAILED, cause)
            return replace(self._felt_last, wrench=self._nothing, on_thing=self._nothing)

    def _allocated(self, wrench_map: WrenchMap, wrench: Array) -> Allocation:
        try:
            return self.allocator.allocate(wrench_map, wrench)
        except HaptorbError as cause:
            self._failed(Trip.CURRENTS_NOT_FINITE, cause)
            return self._no_currents

    def _failed(self, reason: Trip, cause: Exception) -> None:
        if not self.guard.tripped:
            self.error = f"{type(cause).__name__}: {cause}"
        self.guard.trip(reason)

    def _off(self, row: Array, now: float) -> None:
        """What is left to do when the device does not answer: try to switch off, and say so in the row."""
        try:
            self._applied = self.driver.write(self._zeros)
        except HaptorbError:
            self._applied = self._zeros
        row[:] = np.nan
        row[self._one["t"]] = now
        row[self._one["guard"]] = self.guard.state
        row[self._one["trip"]] = self.guard.reason
        row[self._one["gain"]] = 0.0
        row[self._one["world"]] = self.world_changes
        row[self._one["valid"]] = 0.0
        row[self._at["wanted"]] = 0.0
        row[self._at["duties"]] = self._applied
