"""The process that holds the coils: `python -m haptorb.runtime.servo_process FOLDER PARENT`.

It loads what any servo needs, then waits on its standard input for the path of the memory that it shares with its
host; by then the plan lies in the folder. A host that hangs up needs no servo.

A program of its own, not started by `multiprocessing`: a user's script needs no `__main__` guard, and nothing of the
host's (its threads, its garbage, its interpreter lock) can delay a tick.
"""

from __future__ import annotations

import gc
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
from haptorb.compiled import UncompiledKernelError, forbid_compiling, tell_compiling
from haptorb.errors import HaptorbError
from haptorb.runtime import plan as plans
from haptorb.runtime.clock import Clock
from haptorb.runtime.keep_core_awake import CoreWaker
from haptorb.runtime.linux import KillTimer, TickTimeout, die_with_parent, end_group, is_parent_gone, request_real_time
from haptorb.runtime.loop import Loop, load_loop
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.prestart import PLAN
from haptorb.runtime.shared_memory import Phase, SharedMemory, Word
from haptorb.runtime.tick import Chain, Tick
from haptorb.runtime.tick_state import TickState
from haptorb.runtime.trackers.base import Tracker
from haptorb.runtime.trackers.feed_tracker import FeedTracker
from haptorb.runtime.warm_up import Compilation, find_uncompiled, list_companions, practise
from haptorb.runtime.world_change import description
from haptorb.runtime.world_loading import WorldLoader
from haptorb.runtime.world_output import WorldOutput
from haptorb.worlds.base import World
from haptorb.worlds.user_world import keep_source, try_world

__all__ = ["disagreement", "main"]


# --------------------------------------------------------------------------------------------------
# Does the calibration in use belong to the device that responds? The message where they disagree.


def disagreement(stored: bytes | None, believed: bytes | None) -> str:
    """One sentence about the ids that the device keeps and that the controller's calibration has; empty if they agree.

    `stored` None: the device has no memory; zeros: it keeps none. `believed` None: no calibration was given.

    >>> disagreement(bytes(16), None), disagreement(None, b"x" * 16)
    ('', '')
    """
    if stored is None or stored == (believed or bytes(16)):
        return ""
    if believed is None:
        return (
            f"the device was calibrated (id {stored.hex()}), but no calibration is loaded: load its file with "
            "--calibration FILE, or calibration=FILE in Python"
        )
    if not any(stored):
        return (
            f"the device stores no calibration id, the file has {believed.hex()}: check that it was measured on this "
            "device; `haptorb calibrate` stores the id"
        )
    return (
        f"calibration {believed.hex()} is not the one stored on the device, {stored.hex()}: use the last file "
        "measured on this device, or calibrate again"
    )


_REHEARSAL = 5  #: ticks
_BEGIN = 3.0  #: to the first tick, then the loop says [s]
_FORKED = 70  #: exit code of a child that a world forked
_ALWAYS = ("haptorb.runtime.assembly", "haptorb.runtime.drivers.sim", "haptorb.simulation.registry")


def main(folder: Path, parent: int) -> int:
    """Build what the plan says, run it to its end, and say in the shared memory how it ended; returns the exit code.

    The `folder` was made for this process alone.
    """
    _load()  # the host reads a device file meanwhile
    message = sys.stdin.buffer.read()
    die_with_parent()  # at once, as long as there is no coil to be switched off
    if not message:  # safety: plan-awaited
        shutil.rmtree(folder, ignore_errors=True)
        return 0
    shared = SharedMemory.attach(os.fsdecode(message))
    if is_parent_gone(parent):  # it ended before the kernel was asked to tell
        shared.unlink()
        shutil.rmtree(folder, ignore_errors=True)
        return 1
    shared.words[Word.PID] = os.getpid()
    try:
        return _run(shared, folder / PLAN, parent)
    except SystemExit as end:  # asked to end before the driver was open
        shared.reason.write("ended by a signal before it had begun")
        shared.words[Word.PHASE] = Phase.ENDED
        return int(end.code or 0)
    except BaseException as cause:
        text = str(cause) if isinstance(cause, HaptorbError) else "".join(traceback.format_exception(cause))
        shared.reason.write(text[-4000:])
        shared.words[Word.PHASE] = Phase.FAILED
        return 1
    finally:
        if is_parent_gone(parent):  # nothing else will tidy up
            end_group(os.getpid())
            shared.unlink()
            shutil.rmtree(folder, ignore_errors=True)


def _run(shared: SharedMemory, path: Path, parent: int) -> int:
    end_signals = _EndSignals(parent)
    # Who forks in a world would have a second loop at the same device: the child ends before it comes back from there.
    os.register_at_fork(after_in_child=partial(os._exit, _FORKED))  # safety: world-forked
    plan = plans.load(path)
    shared.announce_world(description(plan.config.world))
    gc.disable()  # compiling makes a million lasting objects; to scan them took an eighth of a first start
    tell_compiling(partial(shared.words.__setitem__, Word.COMPILED, 1))  # then another process compiles, too
    with redirect_stdout(None):
        uncompiled = _rehearse(plan, shared)
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
    # What a world prints, warnings included, is the host's to show; a tick must not wait for a terminal.
    sys.stdout = sys.stderr = WorldOutput(1)
    # No collection but this one: another would hold up the loop. What is alive now is never looked at again.
    gc.collect()
    gc.freeze()
    facts = request_real_time()
    wakefulness = CoreWaker(int(facts["core"]))
    try:
        shared.facts.write(json.dumps({**facts, "awake": wakefulness.awake, "collects_garbage": gc.isenabled()}))
        end_signals.loop = loop
        if end_signals.early:
            sys.exit(128 + end_signals.early)
        chain.driver.open()
        believed = None if calibration is None else calibration.id
        shared.warning.write(disagreement(chain.driver.calibration, believed) or chain.remark)
        clock = Clock(plan.config.rate, chain.driver.lead)
        tracker.origin = clock.schedule.origin * 1e-9
        die_with_parent(signal.SIGUSR1)  # in order from here on, with the coils off first ...
        timer.set(_BEGIN)  # ... and by force if that takes long
        well = loop.run(clock)
    finally:
        wakefulness.end()
    gc.enable()
    if well and loop.told_by:
        shared.reason.write(f"ended by {loop.told_by}")
    elif not well:
        shared.reason.write(loop.reason[:4000])
    shared.words[Word.PHASE] = Phase.ENDED if well else Phase.FAILED
    if loop.told_by:
        return 128 + signal.Signals[loop.told_by]
    return 0 if well else 1


def _load() -> None:
    """What any servo needs: its modules, the worlds, and what loading the first compiled function loads with it."""
    for module in _ALWAYS:
        import_module(module)
    for kind in worlds.CATALOGUE.values():
        kind()


def _rehearse(plan: plans.Plan, shared: SharedMemory) -> frozenset[str]:
    """Run a chain of its own for a few ticks: compiled code is loaded now, and not in the first tick.

    Then one tick of every world of the catalogue: who chooses another while the loop runs must not wait for its code,
    and neither must the coils. Those whose code lies in no cache are left to others: a first start is long enough.
    Returns their names.
    """
    for own in (plan.config.world, *plan.own_worlds.values()):
        if type(own) in worlds.CATALOGUE.values():
            continue
        shared.words[Word.FIRST_CALL] = monotonic_ns()  # the host ends one that does not return
        with suppress(HaptorbError):  # said in the first tick, with its place
            try_world(own, plan.config.device)
        shared.words[Word.FIRST_CALL] = 0
    chain = plan.practice(PointerTracker())
    row = shared.layout.empty()
    with chain.driver:
        for tick in range(_REHEARSAL):  # the device alone: at a first start another process compiles the rest
            chain.prepare(tick / plan.config.rate)
        load_loop(row, shared.layout.places)
        for tick in range(_REHEARSAL, 2 * _REHEARSAL):
            chain.step(row, tick / plan.config.rate)
        now = 2 * _REHEARSAL / plan.config.rate
        for own in (plan.config.world, *plan.own_worlds.values()):
            for one in (*list_companions(plan.config.device, own), own):
                practise(chain, one, row, now)
        return frozenset(
            name for name, kind in worlds.CATALOGUE.items() if not _load_code(plan, chain, kind(), row, now)
        )


def _load_code(plan: plans.Plan, chain: Chain, world: World, row: Array, now: float) -> bool:
    """Load the code of `world`, as far as it is compiled; whether all of it is."""
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
    """The source of a request to end this process. Its handlers are in place before the coils can be on."""

    def __init__(self, parent: int) -> None:
        self.loop: Loop | None = None  #: from when on a signal must wait for the present tick
        self.early = 0  #: a signal from before that; its SystemExit may be lost in a callback that swallows exceptions
        self._parent = parent
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._end)
        signal.signal(signal.SIGUSR1, self._on_parent_death)
        signal.signal(signal.SIGUSR2, self._on_stuck_tick)

    def _end(self, number: int, frame: FrameType | None) -> None:
        if self.loop is None:
            self.early = number
            sys.exit(128 + number)
        self.loop.told_by = signal.Signals(number).name

    def _on_parent_death(self, number: int, frame: FrameType | None) -> None:
        if is_parent_gone(self._parent):
            self._end(number, frame)

    def _on_stuck_tick(self, number: int, frame: FrameType | None) -> None:
        """The host saw no tick for a long time. Raised into a step, this ends a loop in there."""
        if self.loop is not None and self.loop.in_step:
            raise TickTimeout(f"world '{self.loop.world}' hangs: one tick took longer than a second")


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), int(sys.argv[2])))
