"""The loop on a controlled clock: a dead host is distinguished from a delay of the whole computer."""

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from fuzz.loop_host import make_host
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import InputError, UnknownName
from haptorb.recording.row import RowLayout
from haptorb.runtime.assembly import assemble
from haptorb.runtime.clock import Schedule
from haptorb.runtime.config import RunConfig
from haptorb.runtime.drivers.sim import SimDriver
from haptorb.runtime.liveness import HEARTBEAT_TIMEOUT_S, STARVED_TIMEOUT_S, ProcessorWait
from haptorb.runtime.loop import Loop
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.servo import Servo
from haptorb.runtime.shared_memory import SharedMemory, Word
from haptorb.worlds import find_world
from haptorb.worlds.user_world import FunctionWorld

RAMPING, RUNNING, TRIPPED = int(GuardState.RAMPING), int(GuardState.RUNNING), int(GuardState.TRIPPED)
RATE = 1000.0
BEAT = 1_000_000_000


class WoundClock:
    """Comes back at the told numbers of periods after the start, one after the other; the host's heart beats or not.

    ahead: which deadline after the last tick's is the first that a loop can still meet; above 1, its tick took long.
    """

    def __init__(self, shared: SharedMemory, ticks: Iterable[int], beating: bool, *, ahead: int = 1) -> None:
        self._ahead = ahead
        self.schedule = Schedule(RATE, BEAT)
        self._shared, self._ticks, self._beating = shared, iter(ticks), beating
        self.waits = 0

    def sleep(self) -> float:
        return self.schedule.time(self.schedule.deadline(self.schedule.number + self._ahead))

    def wait(self) -> tuple[int, int, int]:
        number = next(self._ticks, None)
        if number is None:
            self._shared.words[Word.QUIT] = 1
            number = self.schedule.number + 1
        now = self.schedule.deadline(number)
        if self._beating:
            self._shared.words[Word.HEARTBEAT] = now
        self.waits += 1
        return now, *self.schedule.begin(now)


class Script:
    """A clock's ticks, with deeds of the host between them."""

    def __init__(self, deeds: dict[int, Callable[[], None]], ticks: int) -> None:
        self.deeds, self.ticks = deeds, ticks

    def __iter__(self) -> Iterator[int]:
        for number in range(self.ticks):
            self.deeds.get(number, lambda: None)()
            yield number


def states_after(*deeds: Callable[[Servo], None], apart: int = 50) -> list[int]:
    """State of the guard before the first deed, and `apart` ticks after each."""
    omni, world = load("omni"), find_world("dome")()
    shared = SharedMemory.create(RowLayout.of(omni))
    states: list[int] = []
    try:
        host = make_host(shared)

        def do(deed: Callable[[Servo], None] | None) -> None:
            latest = shared.ring.latest()
            assert latest is not None
            states.append(int(latest[shared.layout["guard"]][0]))
            if deed is not None:
                deed(host)

        chain = assemble(RunConfig(device=omni, world=world, rate=RATE), PointerTracker())
        script = {400 + apart * n: partial(do, deed) for n, deed in enumerate([*deeds, None])}
        clock = WoundClock(shared, Script(script, 401 + apart * len(deeds)), beating=True)
        chain.driver.open()
        Loop(chain, world, shared, RATE, os.getppid()).run(clock)
        return states
    finally:
        shared.unlink()


def test_simulated_coils_cool_when_the_host_says_so_and_real_ones_are_refused() -> None:
    omni, world = load("omni"), find_world("dome")()
    shared = SharedMemory.create(RowLayout.of(omni))
    warmest: list[float] = []
    try:
        host = make_host(shared)

        def look() -> None:
            latest = shared.ring.latest()
            assert latest is not None
            warmest.append(float(latest[shared.layout["winding"]].max()))

        def cool() -> None:
            look()
            host.cool()

        chain = assemble(RunConfig(device=omni, world=world, rate=RATE), PointerTracker())
        clock = WoundClock(shared, Script({2500: cool, 2503: look}, 2504), beating=True)
        chain.driver.open()
        Loop(chain, world, shared, RATE, os.getppid()).run(clock)
        before, after = warmest
        assert before > omni.coils.heat.ambient + 0.5
        assert after < omni.coils.heat.ambient + 0.3
        host.config = replace(host.config, driver="serial:/dev/ttyUSB0")
        with pytest.raises(InputError, match="only simulated coils can be cooled at once"):
            host.cool()
    finally:
        shared.unlink()


def test_an_engage_that_was_asked_for_before_a_stop_is_void() -> None:
    kept: list[int] = []
    states = states_after(
        lambda host: host.stop(),
        lambda host: kept.append(host.stops),  # somebody asks to engage ...
        lambda host: host.stop(),  # ... somebody else stops ...
        lambda host: host.engage(kept[0]),  # ... and the first word arrives late
        lambda host: host.engage(),
    )
    assert states[:5] == [RUNNING, TRIPPED, TRIPPED, TRIPPED, TRIPPED]
    assert states[5] in (RAMPING, RUNNING)


def test_a_world_that_fails_again_in_the_first_tick_after_engage_is_another_trip() -> None:
    omni, fails = load("omni"), False

    def brittle(state: State) -> tuple[float, float, float]:
        if fails:
            raise ValueError("broken")
        return (0.0, 0.0, 0.0)

    def break_it() -> None:
        nonlocal fails
        fails = True

    world = FunctionWorld(brittle)
    shared = SharedMemory.create(RowLayout.of(omni))
    try:
        host = make_host(shared)
        chain = assemble(RunConfig(device=omni, world=world, rate=RATE), PointerTracker())
        clock = WoundClock(shared, Script({400: break_it, 450: host.engage, 500: host.engage}, 550), beating=True)
        chain.driver.open()
        Loop(chain, world, shared, RATE, os.getppid()).run(clock)
        assert shared.words[Word.TRIPS] == 3
        assert [int(code) for _, code in shared.trips[:3].tolist()] == [Trip.WORLD_FAILED] * 3
    finally:
        shared.unlink()


def test_another_model_is_inverted_from_the_next_tick_on() -> None:
    seen: list[float] = []

    def see(host: Servo) -> None:
        seen.append(host.latest()["model"])

    def choose(host: Servo) -> None:
        see(host)
        with pytest.raises(UnknownName, match="did you mean 'published'"):
            host.set_model("publishd")
        assert host.model == "exact"
        host.set_model("published")

    states = states_after(choose, see, lambda host: host.set_model("exact"), see)
    assert seen == [0.0, 2.0, 0.0]
    assert set(states) == {RUNNING}


def test_stop_and_engage_in_one_tick_are_taken_in_their_order() -> None:
    def stop_then_engage(host: Servo) -> None:
        host.stop()
        host.engage()

    def engage_then_stop(host: Servo) -> None:
        host.engage()
        host.stop()

    assert states_after(stop_then_engage)[1] == RAMPING
    assert states_after(lambda host: host.stop(), engage_then_stop)[2] == TRIPPED


@pytest.mark.parametrize(
    ("simulated", "ahead", "state"),
    [(True, 1, RUNNING), (False, 1, TRIPPED), (True, 3, TRIPPED), (False, 3, TRIPPED)],
    ids=["woken late", "woken late, real", "busy", "busy, real"],
)
def test_a_simulated_device_trips_for_slow_ticks_and_not_for_a_busy_computer(simulated, ahead, state) -> None:
    omni, world = load("omni"), find_world("dome")()
    shared = SharedMemory.create(RowLayout.of(omni))
    states: list[float] = []

    def look() -> None:
        latest = shared.ring.latest()
        assert latest is not None
        states.append(latest[shared.layout["guard"]][0])

    try:
        chain = assemble(RunConfig(device=omni, world=world, rate=RATE), PointerTracker())
        chain.driver.simulated = simulated
        script = Script({700: look}, 701)
        ticks = (n if n < 400 else 400 + 3 * (n - 400) for n in script)  # only every third deadline is met
        chain.driver.open()
        Loop(chain, world, shared, RATE, os.getppid()).run(WoundClock(shared, ticks, beating=True, ahead=ahead))
    finally:
        shared.unlink()
    assert states == [state]


@pytest.fixture(autouse=True)
def waits(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Whether the host waits for a processor."""
    waits = [False]
    monkeypatch.setattr(ProcessorWait, "update", lambda self, now: waits[0])
    return waits


def run(ticks: Iterable[int], beating: bool, *, simulated: bool = True) -> tuple[bool, Loop, WoundClock]:
    """Whether the loop ended as it was told, the loop, and the clock."""
    omni, world = load("omni"), find_world("nothing")()
    shared = SharedMemory.create(RowLayout.of(omni))
    try:
        shared.words[Word.HEARTBEAT] = BEAT
        chain = assemble(RunConfig(device=omni, world=world, rate=RATE), PointerTracker())
        chain.driver.simulated = simulated
        loop = Loop(chain, world, shared, RATE, os.getppid())
        clock = WoundClock(shared, ticks, beating)
        chain.driver.open()
        return loop.run(clock), loop, clock
    finally:
        shared.unlink()


SILENT = int(HEARTBEAT_TIMEOUT_S * RATE)


def test_a_host_whose_heart_beats_is_obeyed_to_the_end() -> None:
    well, loop, clock = run(range(2 * SILENT), beating=True)
    assert well
    assert loop.reason == ""
    assert clock.waits == 2 * SILENT + 1


def test_every_tick_is_prepared_for_its_own_deadline_first(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, float]] = []
    for door in ("prepare", "read"):
        inner = getattr(SimDriver, door)
        monkeypatch.setattr(
            SimDriver, door, lambda self, now, inner=inner, door=door: asked.append((door, now)) or inner(self, now)
        )
    run(range(20), beating=True)
    assert asked[:40:2] == [("prepare", now) for _, now in asked[1:40:2]]
    assert [door for door, _ in asked[1:40:2]] == ["read"] * 20
    assert [now for _, now in asked[1:40:2]] == pytest.approx(np.arange(20) / RATE)


def test_a_host_without_a_heartbeat_is_dead_after_the_silence() -> None:
    well, loop, clock = run(range(2 * SILENT), beating=False)
    assert not well
    assert "did not respond" in loop.reason
    assert clock.waits == pytest.approx(SILENT, abs=2)


def test_a_host_that_waits_for_a_processor_has_more_time_where_nothing_real_moves(waits: list[bool]) -> None:
    waits[0] = True
    most = int(STARVED_TIMEOUT_S * RATE)
    well, loop, clock = run(range(2 * most), beating=False)
    assert not well
    assert "busy" in loop.reason
    assert clock.waits == pytest.approx(most, abs=2)
    well, _, clock = run(range(2 * most), beating=False, simulated=False)
    assert not well
    assert clock.waits == pytest.approx(SILENT, abs=2)


def test_a_loop_that_was_held_up_gives_the_host_its_time_again() -> None:
    # The whole computer stood still for two seconds: the loop is back first, and the host had no chance to speak.
    late = 4 * SILENT
    well, _, clock = run([*range(10), *range(late, late + SILENT // 2)], beating=False)
    assert well
    # ... but not for ever.
    well, _, clock = run([*range(10), *range(late, late + 2 * SILENT)], beating=False)
    assert not well
    assert clock.waits == pytest.approx(10 + SILENT, abs=2)


def test_small_delays_of_the_loop_give_nobody_more_time() -> None:
    well, _, clock = run(range(0, 4 * SILENT, 20), beating=False)  # every tick 20 ms late
    assert not well
    assert clock.waits == pytest.approx(SILENT / 20, abs=2)
