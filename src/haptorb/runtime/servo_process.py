"""Servo process, which runs the loop and drives the coils: `python -m haptorb.runtime.servo_process FOLDER PARENT`.

It loads what any servo needs, then waits on its standard input for the path of the memory that it shares with its
host; by then the plan is in the folder. If the host closes the pipe first, the process ends.

It is a separate program, not started by `multiprocessing`: a user's script needs no `__main__` guard, and nothing of
the host's (its threads, its garbage, its interpreter lock) can delay a tick.
"""

from __future__ import annotations

import gc

if __name__ == "__main__":
    # Before the other imports: what they and the compiler create is permanent. Scanning it took a tenth of the time of
    # the imports, and an eighth of a first start.
    gc.disable()

import json
import os
import shutil
import signal
import sys
import traceback
from contextlib import redirect_stdout, suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from time import monotonic_ns
from types import FrameType

from haptorb import worlds
from haptorb.arrays import Array
from haptorb.compiled import UncompiledKernelError, forbid_compiling, on_compiling
from haptorb.errors import HaptorbError
from haptorb.runtime import plan as plans
from haptorb.runtime.clock import Clock
from haptorb.runtime.keep_core_awake import CoreWaker
from haptorb.runtime.linux import (
    END_SIGNALS,
    KillTimer,
    TickTimeout,
    die_with_parent,
    end_group,
    forbid_core_dumps,
    is_linux,
    is_parent_gone,
    request_real_time,
)
from haptorb.runtime.loop import Loop, load_loop
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.prestart import PLAN
from haptorb.runtime.shared_memory import Phase, SharedMemory, Word
from haptorb.runtime.tick import Chain, Tick
from haptorb.runtime.tick_state import TickState
from haptorb.runtime.trackers.base import Tracker
from haptorb.runtime.trackers.feed_tracker import FeedTracker
from haptorb.runtime.warm_up import Compilation, dry_run, find_uncompiled, list_companions
from haptorb.runtime.world_loading import WorldLoader
from haptorb.runtime.world_output import WorldOutput
from haptorb.runtime.world_requests import description
from haptorb.worlds.base import World
from haptorb.worlds.user_world import keep_source, try_world

__all__ = ["disagreement", "main"]


# --------------------------------------------------------------------------------------------------
# Check that the calibration in use belongs to the device that responds.


def disagreement(stored: bytes | None, loaded: bytes | None) -> str:
    """Warning if the calibration id stored in the device differs from the controller's; empty if they agree.

    `stored` None: the device has no memory; zeros: none is stored. `loaded` None: no calibration was given.

    >>> disagreement(bytes(16), None), disagreement(None, b"x" * 16)
    ('', '')
    """
    if stored is None or stored == (loaded or bytes(16)):
        return ""
    if loaded is None:
        return (
            f"the device was calibrated (id {stored.hex()}), but no calibration is loaded: load its file with "
            "--calibration FILE, or calibration=FILE in Python"
        )
    if not any(stored):
        return (
            f"the device stores no calibration id, the file has {loaded.hex()}: check that it was measured on this "
            "device; `haptorb calibrate` stores the id"
        )
    return (
        f"calibration {loaded.hex()} is not the one stored on the device, {stored.hex()}: use the last file "
        "measured on this device, or calibrate again"
    )


_WARM_UP_TICKS = 5  #: ticks of the warm-up
_FIRST_TICK_TIMEOUT_S = 3.0  #: watchdog timeout until the first tick; then the loop sets its own
_FORKED_EXIT_CODE = 70  #: exit code of a child that a world has forked
_ALWAYS = ("haptorb.runtime.assembly", "haptorb.runtime.drivers.sim", "haptorb.simulation.registry")


def main(folder: Path, parent: int) -> int:
    """Build the chain of the plan, run it, and write to the shared memory how it ended; return the exit code.

    The `folder` was created for this process alone.
    """
    forbid_core_dumps()
    _load()  # in parallel with the host, which reads a device file
    message = sys.stdin.buffer.read()
    die_with_parent()  # by SIGKILL, as long as there are no coils to switch off
    if not message:  # safety: plan-awaited
        shutil.rmtree(folder, ignore_errors=True)
        return 0
    shared = SharedMemory.attach(os.fsdecode(message))
    if is_parent_gone(parent):  # it ended before the parent-death signal was requested
        shared.unlink()
        shutil.rmtree(folder, ignore_errors=True)
        return 1
    shared.words[Word.PID] = os.getpid()
    try:
        return _run(shared, folder / PLAN, parent)
    except SystemExit as end:  # requested to end before the driver was open
        shared.reason.write("ended by a signal before it had begun")
        shared.words[Word.PHASE] = Phase.ENDED
        return int(end.code or 0)
    except BaseException as cause:
        text = str(cause) if isinstance(cause, HaptorbError) else "".join(traceback.format_exception(cause))
        shared.reason.write(text[-4000:])
        shared.words[Word.PHASE] = Phase.FAILED
        return 1
    finally:
        if is_parent_gone(parent):  # no other process will clean up
            end_group(os.getpid())
            shared.unlink()
            shutil.rmtree(folder, ignore_errors=True)


def _run(shared: SharedMemory, path: Path, parent: int) -> int:
    end_signals = _EndSignals(parent)
    # A fork in a world would be a second loop on the same device: the child ends before it returns from `fork`.
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=partial(os._exit, _FORKED_EXIT_CODE))  # safety: world-forked
    plan = plans.load(path)
    shared.announce_world(description(plan.config.world))
    on_compiling(partial(shared.words.__setitem__, Word.COMPILED, 1))  # so that another process helps to compile
    with redirect_stdout(None):
        uncompiled = _warm_up(plan, shared)
    shared.words[Word.UNCOMPILED] = len(uncompiled)
    tracker = _tracker(plan, shared)
    chain, calibration = plan.assemble(tracker), plan.config.calibration
    for own in plan.own_worlds.values():
        keep_source(own)
    loader = None
    if plan.reloads or uncompiled:
        loader = WorldLoader(plan.config.device, Compilation(plan.config).make_tick(), path.parent, uncompiled)
    timer = KillTimer()
    loop = Loop(
        chain, plan.config.world, shared, plan.config.rate, parent, timer.set, own_worlds=plan.own_worlds,
        loader=loader, state=TickState(chain) if isinstance(chain, Tick) else None,
    )  # fmt: skip
    # The host shows the output of a world, warnings included; a tick must not wait for a terminal.
    sys.stdout = sys.stderr = WorldOutput(1)
    if shared.words[Word.COMPILED]:
        gc.collect()  # loading alone leaves hardly any garbage; a collection would delay the loop
    gc.freeze()  # existing objects are excluded from any later collection
    facts = request_real_time()
    wakefulness = CoreWaker(int(facts["core"]))
    try:
        shared.facts.write(json.dumps({**facts, "awake": wakefulness.awake, "collects_garbage": gc.isenabled()}))
        end_signals.loop = loop
        if end_signals.early:
            sys.exit(128 + end_signals.early)
        chain.driver.open()
        loaded = None if calibration is None else calibration.id
        shared.warning.write(disagreement(chain.driver.calibration, loaded) or chain.remark)
        clock = Clock(plan.config.rate, chain.driver.lead)
        tracker.origin = clock.schedule.origin * 1e-9
        if is_linux():
            die_with_parent(signal.SIGUSR1)  # from here on an orderly end, with the coils off first ...
        timer.set(_FIRST_TICK_TIMEOUT_S)  # ... enforced by the watchdog
        well = loop.run(clock)
    finally:
        wakefulness.end()
    gc.enable()
    if well and loop.end_signal:
        shared.reason.write(f"ended by {loop.end_signal}")
    elif not well:
        shared.reason.write(loop.reason[:4000])
    shared.words[Word.PHASE] = Phase.ENDED if well else Phase.FAILED
    if loop.end_signal:
        return 128 + signal.Signals[loop.end_signal]
    return 0 if well else 1


def _load() -> None:
    """Load what any servo needs: its modules, the worlds, and the dependencies of a first compiled function.

    Nothing is compiled: this world may not be needed.
    """
    for module in _ALWAYS:
        import_module(module)
    for kind in worlds.CATALOGUE.values():
        with forbid_compiling(), suppress(UncompiledKernelError):
            kind()


def _warm_up(plan: plans.Plan, shared: SharedMemory) -> frozenset[str]:
    """Warm-up: run a separate chain for a few ticks, so that compiled code is loaded now, and not in the first tick.

    Then one tick of every world of the catalogue, so that a change of the world while the loop runs needs no loading.
    Those whose code is not in the cache are left to the compiler process: a first start is long enough. Returns their
    names.
    """
    for own in (plan.config.world, *plan.own_worlds.values()):
        if type(own) in worlds.CATALOGUE.values():
            continue
        shared.words[Word.FIRST_CALL] = monotonic_ns()  # the host kills this process if the call does not return
        with suppress(HaptorbError):  # reported in the first tick, with its place
            try_world(own, plan.config.device)
        shared.words[Word.FIRST_CALL] = 0
    chain = plan.practice(PointerTracker())
    row = shared.layout.empty()
    with chain.driver:
        for tick in range(_WARM_UP_TICKS):  # the device only: at a first start another process compiles the rest
            chain.prepare(tick / plan.config.rate)
        if isinstance(chain, Tick):
            chain.load_allocation()
            chain.load_row(row)
        load_loop(row, shared.layout.places)
        for tick in range(_WARM_UP_TICKS, 2 * _WARM_UP_TICKS):
            chain.step(row, tick / plan.config.rate)
        now = 2 * _WARM_UP_TICKS / plan.config.rate
        for own in (plan.config.world, *plan.own_worlds.values()):
            for one in (*list_companions(plan.config.device, own), own):
                dry_run(chain, one, row, now)
        return frozenset(name for name, kind in worlds.CATALOGUE.items() if not _load_code(plan, chain, kind, row, now))


def _load_code(plan: plans.Plan, chain: Chain, kind: type[World], row: Array, now: float) -> bool:
    """Load the code of the world `kind`, as far as it is compiled; return whether all of it is."""
    try:
        with forbid_compiling():
            world = kind()
    except UncompiledKernelError:
        return False
    if world.remembers:  # without a valid pose the chain does not advance it
        with forbid_compiling() as missing, suppress(HaptorbError, UncompiledKernelError):
            try_world(world, plan.config.device)
        if missing:
            return False
    return not find_uncompiled(chain, world, row, now)


def _tracker(plan: plans.Plan, shared: SharedMemory) -> Tracker:
    if plan.config.has_feed:
        return FeedTracker(shared.tracked, plan.config.prediction)
    return PointerTracker(shared.pointer, signals=shared.hand)


class _EndSignals:
    """Signal handlers that end this process; installed before the coils can be on."""

    def __init__(self, parent: int) -> None:
        self.loop: Loop | None = None  #: once set, a signal takes effect after the current tick
        self.early = 0  #: a signal from before that; a callback may suppress its SystemExit
        self._parent = parent
        for number in END_SIGNALS:
            signal.signal(number, self._end)
        if hasattr(signal, "SIGUSR1"):
            signal.signal(signal.SIGUSR1, self._on_parent_death)
            signal.signal(signal.SIGUSR2, self._on_stuck_tick)

    def _end(self, number: int, frame: FrameType | None) -> None:
        if self.loop is None:
            self.early = number
            sys.exit(128 + number)
        self.loop.end_signal = signal.Signals(number).name

    def _on_parent_death(self, number: int, frame: FrameType | None) -> None:
        if is_parent_gone(self._parent):
            self._end(number, frame)

    def _on_stuck_tick(self, number: int, frame: FrameType | None) -> None:
        """Handle the host's signal that a tick does not end: raise TickTimeout if a step is running."""
        if self.loop is not None and self.loop.in_step:
            raise TickTimeout(f"world '{self.loop.world}' hangs: one tick took longer than a second")


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), int(sys.argv[2])))
