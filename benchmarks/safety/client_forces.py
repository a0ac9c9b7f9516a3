"""Programs that command forces in random order: rate of change of the force, and energy transferred into a hand.

    python benchmarks/safety/client_forces.py [--events N] [--seed S]

The real chain of a simulated Omni runs in one process on a clock that this program winds, with the memory between loop
and servers, two clients of the `haply` service and one of a second server. A hand that only yields holds the tool. An
event is one of: a client begins to push, pulls like a spring, falls silent, leaves and comes back, changes its own
mapping in its messages, is moved by `set_transform`; somebody changes all mappings, or the holder's, over HTTP; what a
client commanded waits for a stopped server; the world changes; Stop, engage, a lost pose; warm coils that give a share
of their current, and are cool again at once.

Checked in every tick, from outside of the guard: what is asked of the coils for clients changes by no more than
`limits.force_rate` × the tick, except that a Stop or trip takes it away at once; a Stop leaves nothing in its own tick;
after a change of client or mapping the force of before keeps its direction until it is zero.
Energy is counted from the true currents, the exact wrench map and the true motion: over each change
of client, session or mapping, what the coils put into the hand beyond what the clients' own commands would have put in.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
from collections import Counter, deque
from dataclasses import replace
from typing import Any

import numpy as np

from haptorb.control.trip_reasons import GuardState
from haptorb.devices.loader import load
from haptorb.estimation.types import HandGoal, Pose
from haptorb.recording.row import RowLayout
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig
from haptorb.runtime.shared_memory import Phase, SharedMemory
from haptorb.runtime.trackers.base import Tracker
from haptorb.runtime.world_requests import description
from haptorb.serve import base, haply_protocol
from haptorb.serve.base import ServedDevice
from haptorb.serve.haply import reply
from haptorb.serve.haply_protocol import Service
from haptorb.worlds import Dome, Fluid, Remote
from haptorb.worlds.client_force import FADE_TIME_S, HOLD_TIME_S

DT = 1e-3
GAPS = (0, 0, 1, 1, 2, 7)  #: ticks between two events
SETTLED = 50  #: ticks after which another world has faded
WINDOW = 0.1  #: after a change, in which its energy is counted [s]
RIPPLE = 0.1  #: of the true force: noise of the current readings, and what the model of the coils lacks
LAG = 3  #: ticks over which the change of the true force is reported too
STRAIGHT = 1e-6  #: of a force that goes to zero, across its direction [N]: rounding
MOST = 1e-3  #: energy of a change beyond the clients' own [J]
PLACE = (0.0, 0.0, 0.052)
WORLDS = (Remote(), Remote(), Remote(limit=0.6), Dome() + Remote(), Fluid() + Remote())
TURNS = [(0, 0, 0, 1), (0, 0, 1, 0), (1, 0, 0, 0), (0.5, 0.5, 0.5, 0.5), (0, 0, 0.02, 1)]


class Hand(Tracker):
    """Rests at one place and gives way to what pushes it: it never moves the tool by itself."""

    def goal(self, now: float) -> HandGoal:
        return HandGoal(np.array(PLACE), np.array([0.0, 0.0, 0.0, 1.0]), now, False, still=True)

    def pose(self, now: float) -> Pose:
        raise AssertionError("a simulated hand has a goal; only a real device is asked for its pose")


class Client:
    """One program: how it pushes, and what it last commanded."""

    def __init__(self) -> None:
        self.law, self.force, self.centre = "silent", np.zeros(3), np.zeros(3)
        self.own, self.since, self.lost = np.zeros(3), -1.0, 0.0  # as commanded, stator's frame

    def wish(self, place: Any) -> list[float]:
        return list(40.0 * (self.centre - place)) if self.law == "spring" else list(self.force)

    def own_force(self, now: float) -> Any:
        """What its own last command alone would be, for as long as a command lasts."""
        late = max(now - self.since - HOLD_TIME_S, now - self.lost if self.lost else 0.0)
        return self.own * min(max(1.0 - late / FADE_TIME_S, 0.0), 1.0)


class Setting:
    def __init__(self, seed: int) -> None:
        self.random, self.clock = random.Random(seed), [100.0]
        for module in (base, haply_protocol):
            module.monotonic = lambda: self.clock[0]  # type: ignore[attr-defined]
        self.device = load("omni")
        self.shared = SharedMemory.create(RowLayout.of(self.device))
        self.shared.words[41] = Phase.RUNNING
        facts = {"driver": "sim", "modes": [], "rate_hz": 1.0 / DT}
        served = [ServedDevice(self.shared, n, os.getppid(), self.device, facts) for n in (0, 1)]
        self.service, self.other = Service(served[0], lambda *event: None), served[1]
        self.clients = [Client(), Client(), Client()]
        self.sessions: list[Any] = [self.service.open("127.0.0.1"), self.service.open("127.0.0.1")]
        self.other_session = self.other.open_session()
        self.tick = assemble(RunConfig(device=self.device, world=WORLDS[0], rate=1.0 / DT, seed=seed), Hand())
        self.world = WORLDS[0]
        self.shared.announce_world(description(self.world))
        self.tick.driver.open()
        self.row = self.tick.layout.empty()
        self.simulation = self.tick.driver.simulation  # type: ignore[attr-defined]
        self.stopped = self.engaged = self.waiting = False
        self.asked, self.gain, self.before, self.alone = np.zeros(3), 0.0, False, 0
        self.forces: deque[Any] = deque(maxlen=LAG + 1)  #: true ones, while all that is asked is a client's
        self.steepest = self.steepest_true = self.steepest_lagged = self.greatest = self.greatest_raw = 0.0
        self.changes, self.ticks, self.passages, self.faults = 0, 0, 0, list[str]()
        self.identity = self.rendered = (0.0, 0.0)  #: who commands, and whose force is rendered: session, mapping
        self.window: list[float] | None = None  # time since the change, true energy, the clients' own
        self.true_force = np.zeros(3)
        self.counts: Counter[str] = Counter()
        self.winding = 300.0
        self.deeds = [
            (10, self.push), (6, self.spring), (4, self.fall_silent), (3, self.leave), (4, self.map_own),
            (3, self.move_own), (4, self.map_all), (3, self.map_holder), (3, self.wait), (3, self.change_world),
            (0.1, self.stop), (3, self.engage), (0.05, self.lose_pose), (0.3, self.warm),
        ]  # fmt: skip

    def close(self) -> None:
        self.shared.unlink()

    # --- events ------------------------------------------------------------------------------------------------------
    def someone(self) -> Client:
        return self.random.choice(self.clients)

    def push(self) -> None:
        client = self.someone()
        client.law = "push"
        way = np.array([self.random.gauss(0, 1) for _ in range(3)])
        client.force = self.random.choice((0.1, 0.5, 1.0, 1.2, 30.0)) * way / np.linalg.norm(way)

    def spring(self) -> None:
        client = self.someone()
        client.law = "spring"
        client.centre = np.array([self.random.uniform(-0.03, 0.03) for _ in range(3)])

    def fall_silent(self) -> None:
        self.someone().law = "silent"

    def leave(self) -> None:
        number = self.random.randrange(3)
        client, now = self.clients[number], self.clock[0]
        client.lost = client.lost or now
        if number < 2:
            self.service.close(self.sessions[number])
            self.sessions[number] = self.service.open("127.0.0.1")
        else:
            self.other.lose(self.other_session)
            self.other_session = self.other.open_session()

    def _say(self, number: int, entry: dict[str, Any]) -> None:
        self.service.answer(self.sessions[number], json.dumps({"inverse3": [entry]}), self.clock[0])

    def map_own(self) -> None:
        preset = self.random.choice(("defaults", "led_front", "arm_front_centered"))
        self._say(self.random.randrange(2), {"configure": {"preset": preset}})

    def move_own(self) -> None:
        turn = dict(zip("xyzw", self.random.choice(TURNS), strict=True))
        self._say(self.random.randrange(2), {"commands": {"set_transform": {"transform": {"rotation": turn}}}})

    def map_all(self, query: str = "") -> None:
        turn = dict(zip("xyzw", self.random.choice(TURNS), strict=True))
        scale = self.random.choice((1.0, -1.0, 2.0))
        name = self.random.choice(("workspace", "mount"))
        body = json.dumps({"rotation": turn, "scale": scale}).encode()
        spaces = [one.space for one in self.sessions]
        holder = self.service.served.holder
        reply(self.service, "POST", f"/inverse3/0/config/{name}{query}", body)
        for one, space in zip(self.sessions, spaces, strict=True):
            if one.number == holder and one.space != space:
                self.faults.append("the holder's mapping was changed by somebody else")

    def map_holder(self) -> None:
        self.map_all(f"?session={self.random.choice(self.sessions).number}")

    def wait(self) -> None:
        """A server is stopped for a while; what its clients sent is read afterwards."""
        self.waiting = True

    def change_world(self) -> None:
        self.world = self.random.choice(WORLDS)
        self.tick.change_world(self.world)
        self.shared.announce_world(description(self.world))

    def stop(self) -> None:
        self.tick.stop()
        self.stopped = True

    def engage(self) -> None:
        self.tick.engage()
        self.engaged, self.stopped = self.engaged or self.stopped, False

    def warm(self) -> None:
        """Coils that are warm get a share of their current for some ticks; then they are cool at once."""
        heat = self.device.coils.heat
        self.winding = heat.derate + self.random.choice((0.2, 0.5, 0.9)) * (heat.stop - heat.derate)
        for _ in range(self.random.choice((3, 20))):
            self.step()
        self.winding = 300.0

    def lose_pose(self) -> None:
        update = self.tick.estimator.update
        self.tick.estimator.update = lambda sample: replace(update(sample), valid=False)  # type: ignore[method-assign]
        self.step()
        self.tick.estimator.update = update  # type: ignore[method-assign]

    # --- ticks -------------------------------------------------------------------------------------------------------
    def command(self) -> None:
        """Every client that is not silent commands, as in each millisecond."""
        now = self.clock[0]
        late = self.random.uniform(0.0, 10.0) if self.waiting else 0.0
        self.waiting = False
        place = self.simulation.state().p - np.array(PLACE)
        for number, client in enumerate(self.clients):
            if client.law == "silent":
                continue
            wish = client.wish(place)
            if number < 2:
                session = self.sessions[number]
                force = dict(zip("xyz", wish, strict=True))
                message = {"inverse3": [{"commands": {"set_cursor_force": {"vector": force}}}]}
                self.service.answer(session, json.dumps(message), now - late)
                stator = session.space.stator_force(wish)
            else:
                self.other.command(self.other_session, wish, arrival=now - late)
                stator = wish
            if late < HOLD_TIME_S:
                client.own, client.since, client.lost = np.array(stator), now - late, 0.0

    def step(self) -> None:
        self.command()
        tick, row = self.tick, self.row
        now = self.clock[0]
        self.shared.client_forces.fill(tick.client, now)
        t = self.ticks * DT
        tick.protection.coils["winding"] = self.winding
        tick.driver.cool()
        tick.prepare(t)
        tick.step(row, t)
        self.shared.ring.publish(row)
        self.ticks += 1
        self.check(now)
        self.clock[0] += DT

    def check(self, now: float) -> None:
        row, at = self.row, self.tick.layout
        client = self.tick.protection.state["guard"]["client"][0][:3].copy()
        asked, gain = row[at["wrench_commanded"]][:3].copy(), float(row[at["gain"]][0])
        self.alone = self.alone + 1 if isinstance(self.world, Remote) else 0
        pure = self.alone > SETTLED  # all that is asked is a client's
        felt = asked if pure else gain * client
        if self.stopped:
            self.stopped = False
            if asked.any() or row[at["duty_applied"]].any():
                self.faults.append("a Stop left a force in its own tick")
        if self.engaged:  # after a Stop, before the tick that obeys it
            self.engaged = False
            if np.linalg.norm(felt) > 1e-9 + self.device.limits.force_rate * DT:
                self.faults.append("engaging after a Stop did not begin at zero")
        if gain >= self.gain and row[at["guard"]][0] != GuardState.TRIPPED and self.before is pure:
            self.steepest = max(self.steepest, float(np.linalg.norm(felt - self.asked)) / DT)
        self.check_passage(felt)
        self.asked, self.gain, self.before = felt, gain, pure
        state, currents = self.simulation.state(), self.simulation._coils["current"]
        force = self.device.wrench_map(state, "exact").force @ currents
        if row[at["guard"]][0] == GuardState.RUNNING and pure:
            self.steepest_true = max(self.steepest_true, float(np.linalg.norm(force - self.true_force)) / DT)
            self.forces.append(force)
            if len(self.forces) > LAG:
                change = float(np.linalg.norm(force - self.forces[0]))
                self.steepest_lagged = max(self.steepest_lagged, change / (LAG * DT))
        else:
            self.forces.clear()
        moved = np.zeros(3) if self.ticks == 1 else state.p - self.place
        work = float(0.5 * (force + self.true_force) @ moved)
        own = sum(max(float(one.own_force(now) @ moved), 0.0) for one in self.clients)
        self.place, self.true_force = state.p.copy(), force
        identity = float(self.tick.client["session"][0]), float(self.tick.client["mapping"][0])
        if identity != self.identity:
            self.identity, self.window = identity, [0.0, 0.0, 0.0]
            self.changes += 1
        if self.window is not None and pure:
            self.window = [self.window[0] + DT, self.window[1] + work, self.window[2] + own]
            self.greatest = max(self.greatest, self.window[1] - self.window[2])
            self.greatest_raw = max(self.greatest_raw, self.window[1])
            if self.window[0] > WINDOW:
                self.window = None

    def check_passage(self, felt: Any) -> None:
        """Until the force of whom it was has become zero, no other's is mixed into it: it keeps its direction."""
        identity = float(self.tick.client["session"][0]), float(self.tick.client["mapping"][0])
        if not self.asked.any():
            self.rendered = identity
        if identity != self.rendered and felt.any():
            self.passages += 1
            way = self.asked / np.linalg.norm(self.asked)
            along = float(felt @ way)
            if along < 0.0 or np.linalg.norm(felt - along * way) > STRAIGHT:
                self.faults.append("another client or mapping was felt before the force of before was zero")

    def run(self, events: int) -> None:
        for _ in range(400):
            self.step()
        weights = [weight for weight, _ in self.deeds]
        for _ in range(events):
            ((_, deed),) = self.random.choices(self.deeds, weights)
            self.counts[deed.__name__] += 1
            deed()
            for _ in range(self.random.choice(GAPS)):
                self.step()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--events", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    setting = Setting(chosen.seed)
    try:
        setting.run(chosen.events)
    finally:
        setting.close()
    rate = setting.device.limits.force_rate
    print(f"{chosen.events} events, {setting.ticks} ticks of 1 ms, {setting.changes} changes of client or mapping")
    print("events: " + ", ".join(f"{name} {count}" for name, count in sorted(setting.counts.items())))
    print(f"through zero: {setting.passages} ticks in which the force of another than who commands went to zero")
    print(f"asked for clients: at most {setting.steepest:.4g} N/s; limit {rate:g} N/s")
    print(
        f"true force of the coils: at most {setting.steepest_true:.4g} N/s from one tick to the next; limit with the "
        f"ripple {(1 + RIPPLE) * rate:g} N/s (over {LAG} ticks {setting.steepest_lagged:.4g} N/s)"
    )
    print(
        f"energy of a change beyond the clients' own commands: at most {1e3 * setting.greatest:.3f} mJ (limit "
        f"{1e3 * MOST:g} mJ); in all {1e3 * setting.greatest_raw:.3f} mJ"
    )
    kept = setting.steepest <= rate * (1 + 1e-6) and setting.greatest <= MOST and not setting.faults
    kept = kept and setting.passages > 0 and setting.steepest_true <= rate * (1 + RIPPLE)
    for fault, count in Counter(setting.faults).items():
        print(f"{count} times: {fault}")
    print("kept" if kept else "BROKEN")
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
