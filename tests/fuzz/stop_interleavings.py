"""Random interleavings of Stop with other commands: no current after a Stop until the coils are engaged again.

    python tests/fuzz/stop_interleavings.py [--interleavings N] [--seed S]

The real loop, chain, guard, console hub, session manager and study pages run in one process on a clock that this
program winds; pages are sockets of its own, a session of a study sits in memory. An interleaving is eight random deeds,
no or a few ticks apart: Stop and engage by Python at once or with a stop count that was read earlier, by two pages of
the console, by participant and experimenter of a study (resume, engage, repeat, pause); the study's thread lagging
behind; pages that go away and come back; a pose that grows old or is lost; a trip; a device that does not answer.
Checked in every tick: after a Stop no duty and no open guard until an engage was asked for after it; every way from off
to on begins with a gain of zero.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.loader import load
from haptorb.errors import DriverError, HaptorbError
from haptorb.recording.row import RowLayout
from haptorb.runtime.assembly import assemble
from haptorb.runtime.clock import Schedule
from haptorb.runtime.config import RunConfig
from haptorb.runtime.drivers.base import Driver
from haptorb.runtime.loop import Loop
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.shared_memory import SharedMemory, Word
from haptorb.runtime.world_requests import request
from haptorb.web import console_hub
from haptorb.worlds import find_world
from haptorb_study.pages.session_manager import SessionManager
from haptorb_study.pages.socket_hub import StudyPage, StudySocketHub
from haptorb_study.prompts import Prompt
from haptorb_study.study_file import study_of

sys.path.append(str(Path(__file__).resolve().parents[1]))  # for `fuzz`, where this file is run as a program

RATE, START = 1000.0, 1_000_000_000
DEEDS, GAPS = 8, (0, 0, 1, 1, 2, 7)
SOON = 0.005  #: from steadying the hand to engaging in the console [s]; 0.1 s there: what matters is what comes between
RAMP = 1e-3 / 0.3 + 1e-9  #: of the gain in one tick
ENGAGED = (GuardState.RAMPING, GuardState.RUNNING, GuardState.DERATED)


class Failing(Driver):
    """The simulated device; `silent_ticks` it does not answer, `lost_ticks` its tracker sees nothing."""

    name, simulated = "sim", True

    def __init__(self, inner: Driver) -> None:
        self.inner, self.silent_ticks, self.lost_ticks = inner, 0, 0

    def open(self) -> None:
        self.inner.open()

    def close(self) -> None:
        self.inner.close()

    def read(self, now: float) -> Any:
        if self.silent_ticks:
            self.silent_ticks -= 1
            raise DriverError("the device does not answer")
        sample = self.inner.read(now)
        if self.lost_ticks:
            self.lost_ticks -= 1
            return replace(sample, pose=replace(sample.pose, valid=False))
        return sample

    def write(self, duties: Any) -> Any:
        if self.silent_ticks:
            raise DriverError("the device does not answer")
        return self.inner.write(duties)

    def engage(self) -> None:
        if self.silent_ticks:
            raise DriverError("the device does not answer")

    def wrench_actual(self) -> Any:
        return self.inner.wrench_actual()

    def hand_goal(self) -> Any:
        return self.inner.hand_goal()


class Host:
    """The servo as console and study use it, over memory that the loop reads; its time is the loop's."""

    def __init__(self, shared: SharedMemory) -> None:
        from fuzz.loop_host import make_host  # this file is a program, too

        self._servo = make_host(shared, "dome")
        self._shared, self.now, self._changes = shared, 0.0, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._servo, name)

    @property
    def hand(self) -> Host:
        """It takes the commands to the hand itself."""
        return self

    def release(self) -> None:
        self._servo.hand.release()

    def open(self) -> None:
        return

    def close(self) -> None:
        self.stop()

    def rows(self, cursor: int = 0, most: int | None = None) -> Any:
        return self._shared.ring.read_since(cursor, most)

    def latest(self) -> Any:
        return self._shared.ring.latest()

    def report(self) -> dict[str, Any]:
        return {"trips": []}

    def point(self, p: Any, q: Any = None, *, keep_alive: float = 0.0) -> None:
        self._shared.pointer.write(True, np.asarray(p, float), np.array([0.0, 0, 0, 1]), self.now)

    def set_world(self, name: str, values: Any = None) -> None:  # nobody waits for the answer: the loop is this thread
        self._changes += 1
        self._shared.request.write(request(self._changes, name, values or {}))


class Sitting:
    """A session that never ends, in memory."""

    question, over, id, code = None, False, 1, "P1"

    def __init__(self, engine: Any, study: Any, code: str) -> None:
        self.study, self.number, self.stored = study, 1, 0
        self.history: list[dict[str, Any]] = []
        self.prompt = Prompt(condition=study.conditions[0].name, set_point=1)

    def record_event(self, kind: str, text: str = "", **more: Any) -> None:
        return

    def store_late_events(self) -> None:
        return

    def answer(self, answer: Any, **more: Any) -> None:
        return

    def abort(self, reason: str = "") -> None:
        return

    def close(self) -> None:
        return


class Socket:
    """A page of the console."""

    def __init__(self) -> None:
        self.scope: dict[str, Any] = {"subprotocols": []}
        self.inbox: asyncio.Queue[dict[str, Any]] = asyncio.Queue()

    def say(self, command: dict[str, Any]) -> None:
        self.inbox.put_nowait({"type": "websocket.receive", "text": json.dumps(command)})

    def hang_up(self) -> None:
        self.inbox.put_nowait({"type": "websocket.disconnect"})

    async def accept(self, *_: Any) -> None:
        return

    async def receive(self) -> dict[str, Any]:
        return await self.inbox.get()

    async def send_text(self, *_: Any) -> None:
        return

    async def send_bytes(self, *_: Any) -> None:
        return

    async def close(self, *_: Any) -> None:
        return


class WoundLoop(asyncio.SelectorEventLoop):
    """An event loop whose time is the servo's."""

    now = 0.0

    def time(self) -> float:
        return self.now

    def spin(self, turns: int = 4) -> None:
        for _ in range(turns):
            self.call_soon(self.stop)
            self.run_forever()


class BrokenPromise(Exception):
    """A promise was not kept."""


class Trial:
    """Winds the loop's clock and does deeds between its ticks."""

    def __init__(self, interleavings: int, seed: int) -> None:
        self.left, self.random, self.done = interleavings, random.Random(seed), Counter[str]()
        omni = load("omni")
        self.shared = SharedMemory.create(RowLayout.of(omni))
        self.shared.words[Word.HEARTBEAT] = START
        self.schedule = Schedule(RATE, START)
        tracker = PointerTracker(self.shared.pointer, START * 1e-9)
        self.chain = assemble(RunConfig(device=omni, world=find_world("dome")(), rate=RATE, seed=seed), tracker)
        self.chain.driver = self.device = Failing(self.chain.driver)
        self.host = Host(self.shared)
        self.aio = WoundLoop()
        asyncio.set_event_loop(self.aio)
        console_hub.ENGAGE_DELAY_S = SOON
        self.console = console_hub.ConsoleSocketHub(self.host, None)
        self.pages: list[Socket] = []
        study = study_of('name = "stop"\n[trials]\nrepetitions = 2')
        self.manager = SessionManager(None, study, lambda file: self.host, open_session=Sitting)  # type: ignore[arg-type]
        self.study = StudySocketHub(self.manager, "token", "token", {}, {})
        self.participant = StudyPage(SimpleNamespace(), participant=True)  # type: ignore[arg-type]
        self.experimenter = StudyPage(SimpleNamespace(), participant=False)  # type: ignore[arg-type]
        self.study.register(self.participant)
        self.study.register(self.experimenter)
        self.stopped, self.engaged = 0, 1  # the last deed of either kind, by number; the start engages by itself
        self.number = 1
        self.stops: list[tuple[int, int]] = []  # stop counts that were read for an engage to come
        self.off, self.gain = True, 0.0
        self.fault = ""  # of this program's stand-ins: with it nothing is proved
        self.trail: list[str] = []
        self.plan: list[tuple[int, Callable[[], None]]] = []
        self.gap = 0
        self.deeds = [
            (4, self.python_stop), (4, self.python_engage), (3, self.python_ask), (3, self.python_engage_late),
            (4, self.console_stop), (6, self.console_engage), (1, self.console_leave), (2, self.participant_stop),
            (2, self.experimenter_pause), (5, self.experimenter_resume), (3, self.experimenter_engage),
            (1, self.experimenter_repeat), (1, self.participant_leave), (6, self.study_step), (2, self.trip),
            (1, self.silence_device), (1, self.lose_tool), (1, self.hold), (1, self.release), (2, self.agree),
        ]  # fmt: skip

    # --- deeds -------------------------------------------------------------------------------------------------------
    def stop_given(self) -> None:
        self.number += 1
        self.stopped = self.number

    def engage_given(self) -> int:
        self.number += 1
        self.engaged = self.number
        return self.number

    def python_stop(self) -> None:
        self.stop_given()
        self.host.stop()

    def python_engage(self) -> None:
        self.engage_given()
        self.host.engage()

    def python_ask(self) -> None:
        self.stops.append((self.host.stops, self.engage_given()))

    def python_engage_late(self) -> None:
        if self.stops:
            stops, _ = self.stops.pop(self.random.randrange(len(self.stops)))
            self.host.engage(stops)

    def page(self) -> Socket:
        while len(self.pages) < 2:
            self.pages.append(socket := Socket())
            task = self.aio.create_task(self.console.join(socket))  # type: ignore[arg-type]
            task.add_done_callback(self.check_page)
            self.aio.spin()
        return self.random.choice(self.pages)

    def check_page(self, task: asyncio.Task[None]) -> None:
        if not task.cancelled() and task.exception() is not None:
            self.fault = f"a page of the console failed: {task.exception()!r}"

    def console_stop(self) -> None:
        page = self.page()
        self.stop_given()
        page.say({"do": "stop"})
        self.aio.spin()

    def console_engage(self) -> None:
        page = self.page()
        self.engage_given()
        page.say({"do": "engage"})
        self.aio.spin()

    def console_leave(self) -> None:
        page = self.page()
        self.pages.remove(page)
        page.hang_up()
        self.aio.spin()

    def participant_stop(self) -> None:
        self.stop_given()
        self.study.handle_message(self.participant, '{"do": "stop"}')

    def experimenter_pause(self) -> None:
        self.stop_given()
        self.study.handle_message(self.experimenter, '{"do": "pause"}')

    def experimenter_resume(self) -> None:
        self.engage_given()
        self.study.handle_message(self.experimenter, '{"do": "resume"}')

    def experimenter_engage(self) -> None:
        self.engage_given()
        self.study.handle_message(self.experimenter, '{"do": "engage"}')

    def experimenter_repeat(self) -> None:
        self.study.handle_message(self.experimenter, '{"do": "repeat"}')

    def agree(self) -> None:
        self.study.handle_message(self.participant, '{"do": "agree", "agreed": true}')

    def participant_leave(self) -> None:
        self.stop_given()
        self.study.unregister(self.participant)
        self.study.register(self.participant)

    def study_step(self) -> None:
        self.manager.step()

    def trip(self) -> None:
        self.chain.protection.trip(self.random.choice((Trip.WORLD_FAILED, Trip.OVERCURRENT)))

    def silence_device(self) -> None:
        self.device.silent_ticks = self.random.choice((1, 2, 6))

    def lose_tool(self) -> None:
        self.device.lost_ticks = self.random.choice((1, 3))

    def hold(self) -> None:
        self.host.point((0.0, 0.0, 0.05))

    def release(self) -> None:
        self.host.release()

    # --- the clock ---------------------------------------------------------------------------------------------------
    def sleep(self) -> float:
        return self.schedule.time(self.schedule.deadline(self.schedule.number + 1))

    def wait(self) -> tuple[int, int, int]:
        self.look()
        while self.gap <= 0 and (self.plan or self.left > 0):
            if not self.plan:
                self.left -= 1
                self.trail = []
                weights = [weight for weight, _ in self.deeds]
                for _, deed in self.random.choices(self.deeds, weights, k=DEEDS):
                    self.plan.append((self.random.choice(GAPS), deed))
            self.gap, deed = self.plan.pop(0)
            self.done[deed.__name__] += 1
            self.trail.append(f"{deed.__name__}@{self.schedule.number}")
            try:
                deed()
            except HaptorbError as mistake:
                self.trail.append(str(mistake))
        self.gap -= 1
        now = self.schedule.deadline(self.schedule.number + 1)
        self.shared.words[Word.HEARTBEAT] = now
        self.shared.words[Word.QUIT] = int(self.left == 0 and not self.plan)
        self.host.now = now * 1e-9
        self.aio.now = now * 1e-9
        if self.schedule.number % 2 == 0:
            self.aio.spin(2)
        return now, *self.schedule.begin(now)

    def look(self) -> None:
        """Were the promises kept in the last tick?"""
        if self.fault:
            raise BrokenPromise(self.fault)
        row = self.shared.ring.latest()
        if row is None:
            return
        at = self.shared.layout
        state, gain = int(row[at["guard"]][0]), float(row[at["gain"]][0])
        # A pose that expired fades for 50 ms; that is on its way to off, and a Stop ends it at once.
        on = state in ENGAGED or bool(row[at["duty_applied"]].any()) or gain > 0.0
        if on and self.engaged < self.stopped:
            raise BrokenPromise(f"on after a Stop, guard {state}, gain {gain:g}")
        rise = gain - self.gain
        if state in ENGAGED and rise > RAMP:
            raise BrokenPromise(f"the gain rose from {self.gain:g} to {gain:g}")
        if state in ENGAGED and self.off:
            self.done["off to on"] += 1
            if gain > RAMP:
                raise BrokenPromise(f"on with a gain of {gain:g}")
        self.done["ticks"] += 1
        self.off, self.gain = state not in ENGAGED, gain

    def run(self) -> str:
        """How a promise was broken; empty: all were kept."""
        try:
            self.device.open()
            self.manager.enqueue({"do": "begin", "code": "P1"}, lambda text: None)
            self.manager.step()
            if self.manager.now == "failed":
                return f"no session: {self.manager.trouble}"
            loop = Loop(self.chain, find_world("dome")(), self.shared, RATE, os.getppid())
            well = loop.run(self)  # type: ignore[arg-type]
            return "" if well else f"the loop ended: {loop.reason}"
        finally:
            self.shared.unlink()


def main() -> int:
    """Exit code 1 if a promise was broken."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--interleavings", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    trial = Trial(arguments.interleavings, arguments.seed)
    broken = trial.run()
    done = trial.done
    made = arguments.interleavings - trial.left
    print(f"{made} interleavings, {done['ticks']} ticks, {done['off to on']} times from off to on")
    print(", ".join(f"{name} {count}" for name, count in sorted(done.items()) if name not in ("ticks", "off to on")))
    if broken:
        print(f"NOT kept: {broken}\nthe last deeds: {' '.join(trial.trail)}")
        return 1
    print("kept: never on after a Stop unless an engage was asked for after it; every off to on begins at zero")
    return 0


if __name__ == "__main__":
    sys.exit(main())
