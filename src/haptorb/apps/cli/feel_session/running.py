"""A feel session on its servo: with console and terminal, or with a simulated hand alone."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import suppress
from threading import Event, Thread
from typing import TYPE_CHECKING, Literal

from haptorb.apps.cli.feel_session.choice import DesignChoice
from haptorb.apps.cli.feel_session.limits import StabilityCheck, find_limits
from haptorb.apps.terminal import say

if TYPE_CHECKING:
    from haptorb.apps.feel import Candidate, Candidates, FeelSession
    from haptorb.apps.feel.live_session import LiveSession
    from haptorb.apps.feel.true_scale import TrueScale
    from haptorb.devices.device import Device
    from haptorb.runtime.servo.servo import Servo

__all__ = ["feel_with_console", "feel_without_console", "find_scale"]

_EVERY = 0.05  #: between two looks at the servo's rows [s]


def find_scale(device: str, designs: Sequence[Candidate], candidates: Candidates) -> tuple[Device, TrueScale]:
    """The device, and what a force at the part is in the hand on it.

    Raises InputError if it has no handle, or cannot render one of `designs`.
    """
    from haptorb.apps.feel.true_scale import TrueScale
    from haptorb.control.clutch.gains import MOTOR_GAINS
    from haptorb.devices.loader import load
    from haptorb.worlds.own.failure import try_world

    motor = load(device)
    scale = TrueScale.of(motor, MOTOR_GAINS.scale(float(candidates.gains.torque_per_motion[0])))
    for design in designs:
        try_world(design.world, motor)
    return motor, scale


def _servo(device: str, design: Candidate, candidates: Candidates, *, record: Literal[False] | None = None) -> Servo:
    from haptorb.control.clutch.gains import MOTOR_GAINS
    from haptorb.runtime.servo.servo import Servo

    # The file scales torques; how far the handle moves the part is the motor's matter.
    gains = MOTOR_GAINS.scale(float(candidates.gains.torque_per_motion[0]))
    return Servo(device, design.world, gains=gains, record=record)


def feel_without_console(
    store: FeelSession, design: Candidate, device: str, seconds: float, person: str, score: int | None
) -> None:
    """A simulated hand pulls `design` out and puts it back; its trace is stored, and `score` if there is one."""
    from haptorb.apps.feel.trace import Trace, trace_rows

    servo = _servo(device, design, store.candidates)
    with servo:
        servo.run(seconds)
    trace = Trace(design)
    recording = servo.recording
    trace.extend(trace_rows(servo.layout, recording.rows))
    name = store.keep(trace, person=person) if len(trace) else ""
    if score is not None:
        store.rate(design.name, score, person=person, trace=name)
    say(f"{design.title}: rendered for {len(trace) * 1e-3:.1f} s" + (f", rated {score}" if score else ""))


def feel_with_console(
    live: LiveSession, choice: DesignChoice, device: str, scale: TrueScale, port: int, browser: bool
) -> int:
    """Designs felt and rated in page and terminal until the session is finished; the signal's number, or 0."""
    from haptorb.apps.console import Console
    from haptorb.apps.console.target import target_scene
    from haptorb.apps.feel.design_panel import DesignPanel
    from haptorb.apps.feel.terminal_input import HELP, read_lines, wait_for_lines
    from haptorb.apps.feel.trace_collector import world_key
    from haptorb.apps.web.server import freeze_garbage
    from haptorb.runtime.exchange.world_change import name_of
    from haptorb.worlds.parameter import values as parameter_values

    for design in live.designs:  # computed now: while the servo runs, a hand would wait for it
        target_scene(name_of(design.world), parameter_values(design.world))
    servo = _servo(device, live.current, live.candidates, record=False)
    for number, design in enumerate(live.designs):
        servo.add_world(design.world, world_key(number))
    ended = Event()

    def collect() -> None:
        while not ended.wait(_EVERY):
            live.collect()

    def listen() -> None:
        with suppress(OSError, ValueError):  # no standard input at all
            read_lines(live, wait_for_lines(sys.stdin.fileno(), ended.is_set), say)

    check = StabilityCheck(choice, device, [design.name for design in live.designs])

    def judge() -> None:
        margin = check.wait()
        if not ended.is_set():
            live.set_limits(find_limits(scale, live.designs, margin))

    threads = [Thread(target=work, name=f"haptorb-{work.__name__}") for work in (collect, listen, judge)]
    with Console(servo, port, designs=DesignPanel(live)) as console, freeze_garbage(), servo:
        live.join(servo)
        live.notify = say
        say(f"Open {console.url} in a browser. Ctrl-C ends.\n{HELP}\nnow: {live.label}")
        for thread in threads:
            thread.start()
        try:
            ended_by = console.serve(open_browser=browser, until=lambda: live.finished)
            servo.check_end()
        finally:
            servo.end_loop()
            ended.set()
            check.close()
            for thread in threads:
                thread.join()
            live.collect()
    live.close()
    return ended_by or 0
