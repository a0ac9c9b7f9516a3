"""A recording run again: what the driver had read goes through the same `Tick`, and every number is compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from haptorb.errors import HaptorbError, RecordingError
from haptorb.numerics.arrays import Array
from haptorb.numerics.state_arrays import StateArray
from haptorb.runtime.exchange.world_change import description, name_of
from haptorb.runtime.realtime.schedule import check_rate
from haptorb.runtime.recording.recording import Recording
from haptorb.runtime.replay.comparison import CLOCK_FIELDS, RunComparison, are_same
from haptorb.runtime.replay.garbage import without_collection
from haptorb.runtime.replay.kept_states import KeptStates, find_gaps, list_gaps
from haptorb.runtime.replay.played_commands import play_commands
from haptorb.runtime.replay.played_driver import PlayedDriver
from haptorb.runtime.replay.played_rows import PlayedRows
from haptorb.runtime.replay.recorded_run import RecordedRun
from haptorb.runtime.replay.recorded_world import (
    PlayedBudget,
    RecordedTick,
    list_memory_fields,
    make_recorded_world,
)
from haptorb.runtime.replay.replay_file import ReplayFile, write_replay
from haptorb.runtime.replay.timetable import Timetable
from haptorb.runtime.row import RowLayout
from haptorb.runtime.tick.tick_log import NO_TICK, TickCommand
from haptorb.runtime.tick.tick_state import load_state
from haptorb.worlds.dynamic.remote_sum import join_remote
from haptorb.worlds.dynamic_world import DynamicWorld
from haptorb.worlds.world import World

__all__ = ["Replay"]

_BLOCK = 1024  #: ticks
_CHANGES = 1000  #: of the world, from one tick to the next, at most
_REPLACE = int(TickCommand.REPLACE)


@final
class Replay:
    """Runs `recording` again; `run` does it, once.

    world, estimator, model, rate  stand in for the recorded ones; rate in [Hz]
    recorded_world  render the recorded wrench, and run no world
    part, rows  the rows from one up to another only, the first of which the recording keeps the state; rows, if at hand

    comparison  of what was recorded and what came out
    replaced    part → what stands in for it
    remarks     what is not as it was in the run
    approximate  something that a replay to the bit needs is missing: the result is near
    seconds     length of the run [s]

    Raises RecordingError for a recording that cannot be replayed, and what the chain raises for parts that do not fit.
    """

    def __init__(
        self,
        recording: Recording,
        *,
        world: World | None = None,
        estimator: str | None = None,
        model: str | None = None,
        rate: float | None = None,
        recorded_world: bool = False,
        part: tuple[int, int] | None = None,
        rows: PlayedRows | None = None,
    ) -> None:
        self._recording = recording
        self._rows, self.recorded = rows or PlayedRows(recording), RecordedRun(recording)
        given = {
            "world": world and name_of(world), "estimator": estimator, "model": model, "rate": rate and f"{rate:g} Hz",
        }  # fmt: skip
        self.replaced = {name: str(one) for name, one in given.items() if one}
        self.rate = self.recorded.rate if rate is None else check_rate(rate)
        self._first = part[0] if part else 0
        device = self.recorded.device
        self._driver, self._other_world, self._only_recorded = PlayedDriver(device.sensors), world, recorded_world
        self.remarks = self.recorded.remarks
        self._stand_ins: set[str] = set()
        self._recorded_tick = RecordedTick()
        self._change, self._resampled = 0, rate is not None
        self._state: Mapping[str, StateArray] | None = None
        self._begin_late()
        self._has_clients = False
        first = self._choose_world(self._change)
        self.tick = self.recorded.make_tick(first, self._driver, self.rate, estimator, model)
        self.tick.world_changes = self._change
        # All rows are needed only now: the chain's code was loaded while another process unpacked them.
        table = Timetable(self._rows.t, self._rows.commands, rate)
        self._length, self.seconds = len(table), float(table.t[-1] - table.t[0]) + 1.0 / self.rate
        self._timetable = table if part is None else table.cut(*part)
        self._find_gaps()
        self._take_state()
        self.tick.budget = PlayedBudget(self._recorded_tick)
        self.approximate = bool(self._rows.missing) or self._near
        room = next((field.width for field in recording.fields if field.name == "memory"), 0)
        self._layout = RowLayout.of(device, room)
        self._alike = [(one.name, one.width) for one in recording.fields] == [
            (one.name, one.width) for one in self._layout.fields if one.width
        ]
        self.comparison = RunComparison(self._layout.fields, frozenset(self._rows.missing))

    def __len__(self) -> int:
        return self._length

    @property
    def missing(self) -> tuple[str, ...]:
        """Fields that the recording does not have, and without which its replay is only near."""
        return self._rows.missing

    def read_recorded(self, names: Sequence[str]) -> dict[str, Array]:
        """Field → (n, width) of all recorded ticks, in its unit [SI]."""
        block = self._rows.split(self._rows.read(0, len(self._rows)))
        return {name: block[name] for name in names}

    def write_to(self, path: Path) -> AbstractContextManager[ReplayFile]:
        """The recording of what comes out: whole at the end of the block, or not at all."""
        world = "" if self._other_world is None else description(self._other_world)
        return write_replay(path, self._recording, self._layout, self.rate, self.replaced, world)

    @property
    def layout(self) -> RowLayout:
        """Of the rows that come out: with the room for memory that the recording's have."""
        return self._layout

    def run(
        self,
        report: Callable[[int], None] = lambda ticks: None,
        keep: Callable[[Array], None] = lambda rows: None,
    ) -> RunComparison:
        """All ticks; `report` receives the number done, `keep` rows (n, width), each number in its unit."""
        table, layout = self._timetable, self._layout
        with without_collection(), np.errstate(all="ignore"):  # anybody's numbers
            for first in range(0, len(table), _BLOCK):
                last = min(first + _BLOCK, len(table))
                index = table.index[first:last]
                recorded = self._rows.read(int(index[0]), int(index[-1]) + 1)
                if self._resampled:
                    recorded = recorded[index - index[0]]
                block, t = self._rows.split(recorded), table.t[first:last]
                out = self._run_block(block, t, table.commands[first:last], index)
                self._copy_clock(out, block, first)
                run = ~self._blind[index]
                if first == 0 and self._state is not None:
                    run[0] = False
                if self._alike and run.all() and are_same(recorded, out):
                    self.comparison.add_same(len(out))
                else:
                    fields = {field.name: out[run, layout[field.name]] for field in layout.fields}
                    block = {name: values[run] for name, values in block.items()}
                    self.comparison.add(block, fields, self._rows.ticks[index[run]], t[run])
                keep(out)
                report(last)
        return self.comparison

    def skip_to(self, first: int, last: int) -> bool:
        """Before `run`: replay only the rows `first` up to `last`, with this chain, which is as new. False: it cannot,
        as the recording keeps no state of the row `first`, or another world was felt there."""
        block = self._rows.read_one(first)
        tick, change = float(block["tick"][0, 0]), np.nan_to_num(block["world"][0, 0])
        if self._state is not None or tick not in self._states or change != self._change:
            return False
        self._first, self._state = first, self._states.read(tick)
        self._timetable = Timetable(self._rows.t, self._rows.commands).cut(first, last)
        self._take_state()
        return True

    def _begin_late(self) -> None:
        """A trip's black box begins in the middle of its run, with what the chain remembered there."""
        self._near, self._states = bool(self._rows.missing), KeptStates(self._recording)
        if self._recording.truncated:
            self.remarks.append("the recording was cut short")
        self.remarks += self._recording.damage
        block = self._rows.read_one(self._first)
        tick = float(block["tick"][0, 0])
        if self._states.older:
            self.remarks.append(
                "its stored states of the loop are of an older version and are not read: the replay starts at its "
                "first tick"
            )
        if not tick > 0.0:
            return
        if tick in self._states:
            self._state = self._states.read(tick)
        elif self._states.older:
            self._near = True
        else:
            self._near = True
            self.remarks.append(f"its first tick is {tick:.0f}, and the state of the loop at that tick is missing")
        self._change = int(np.nan_to_num(block["world"][0, 0]))

    def _find_gaps(self) -> None:
        """Where ticks were lost, the chain's memory is unknown."""
        rows = self._rows
        self._blind, self._resume = find_gaps(rows.ticks, self._states)
        if len(gaps := list_gaps(rows.ticks)):
            self.remarks.append(
                f"{len(gaps)} gaps with lost ticks, first after tick {rows.ticks[gaps[0]]:.0f}: "
                f"{int(self._blind.sum())} ticks up to the next stored state of the loop are not compared"
            )

    def _go_on(self, at: int, block: Mapping[str, Array], n: int) -> None:
        """After lost ticks: remember what the recorded chain did after row `at`, tick `n` of the block."""
        self._change_world(float(block["world"][n, 0]), 0)
        memory = block.get("memory", np.empty((n + 1, 0)))[n]
        load_state(self.tick, self._states.read(float(self._rows.ticks[at])), memory)

    def _take_state(self) -> None:
        """Remember what the recorded chain did after the first row, which is not run again."""
        if self._state is not None:
            block = self._rows.read_one(self._first)
            load_state(self.tick, self._state, block.get("memory", np.empty((1, 0)))[0])
            self._timetable.commands[0] = NO_TICK
        if not (self._resampled or self.replaced):
            for at in self._resume:
                if self._first < at < self._first + len(self._timetable):
                    self._timetable.commands[at - self._first] = NO_TICK

    def _run_block(self, block: Mapping[str, Array], t: Array, commands: Array, index: NDArray[np.intp]) -> Array:
        driver, tick, recorded = self._driver, self.tick, self._recorded_tick
        driver.load(block, t)
        recorded.load(block, whole=bool(self._stand_ins) or self._only_recorded or self._has_clients)
        out = np.full((len(t), self._layout.width), np.nan)
        changes, scales = block["world"][:, 0].tolist(), block["torque_scale"][:, 0].tolist()
        step = tick.step
        for n, (now, command, change, row) in enumerate(zip(t.tolist(), commands.tolist(), changes, out, strict=True)):
            if command:
                if command < 0.0:
                    self._copy_row(row, block, n)
                    if int(index[n]) in self._resume:
                        self._go_on(int(index[n]), block, n)
                    continue
                driver.go_to(n)
                play_commands(tick, int(command), scales[n])
            if change != self._change:
                self._change_world(change, int(command))
                recorded.load(block, whole=bool(self._stand_ins) or self._only_recorded or self._has_clients)
            driver.go_to(n)
            recorded.go_to(n)
            if self._has_clients:
                recorded.fill_client(tick.client)
            step(row, now)
        return out

    def _change_world(self, change: float, command: int) -> None:
        """The world has changed up to number `change`; `command` says whether the last one was another version."""
        if not change > self._change:  # NaN: unknown
            return
        if not change - self._change <= _CHANGES:  # safety: changes-are-counted
            raise RecordingError(
                f"{self._recording.path} cannot be replayed: its world changes {change - self._change:g} times from "
                "one tick to the next"
            )
        for number in range(self._change + 1, int(change) + 1):
            world = self._choose_world(number)
            last = number == int(change)
            if last and command & _REPLACE:
                self.tick.replace_world(world)
            else:
                self.tick.change_world(world)
        self._change = int(change)

    def _choose_world(self, change: int) -> World:
        """The world after `change` changes: the recorded one, or another in its place beside the same clients."""
        other = self._other_world
        world = self._find_world(change) if other is None else join_remote(other, self.recorded.remote(change))
        self._has_clients = isinstance(world, DynamicWorld) and world.takes_commands
        if self._has_clients:  # what they commanded is in the recorded memory
            fields = list_memory_fields(self.recorded.describe_world(change))
            self._recorded_tick.find_client(fields, self._recording)
        return world

    def _find_world(self, change: int) -> World:
        """The world after `change` changes, or what was recorded of it."""
        text = self.recorded.describe_world(change)
        if not self._only_recorded:
            try:
                return self.recorded.world(change)
            except HaptorbError as cause:
                name = text[:60]
                if name not in self._stand_ins:
                    self._stand_ins.add(name)
                    self.remarks.append(f"the recorded wrench is replayed instead of a world: {cause}")
        return make_recorded_world(text, self._recorded_tick)

    def _copy_clock(self, out: Array, block: Mapping[str, Array], first: int) -> None:
        for name in CLOCK_FIELDS:
            if name in block:
                place = self._layout[name]
                out[:, place] = block[name][:, : place.stop - place.start]
        if self._resampled:
            out[:, self._layout["tick"].start] = np.arange(first, first + len(out))

    def _copy_row(self, row: Array, block: Mapping[str, Array], n: int) -> None:
        for field in self._layout.fields:
            if field.name in block:
                values = block[field.name][n][: field.width]
                start = self._layout[field.name].start
                row[start : start + len(values)] = values
