"""`haptorb feel`: candidate designs from a file, felt one after another, rated, compared: Bai 2012, Fig. 5(a)."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from haptorb.cli.keys import FILES, FileKeys, KeySection
from haptorb.cli.run import AddressOption, HostOption
from haptorb.errors import InputError
from haptorb.figure_file import check_figure_file
from haptorb.terminal import Column, TextTable, make_console, notify, print_json, print_table, queue_output
from haptorb_study.feel.limits import DesignChoice, StabilityCheck, find_limits

if TYPE_CHECKING:
    from haptorb.devices.base import Device
    from haptorb.runtime.servo import Servo
    from haptorb.web.server import PageAddress
    from haptorb_study.feel import Candidate, Candidates, FeelSession
    from haptorb_study.feel.live_session import LiveSession
    from haptorb_study.feel.torque_scale import TrueScale

__all__ = ["feel_with_console", "feel_without_console", "find_scale", "list_feel_sections", "register"]


def list_feel_sections() -> list[KeySection]:
    """The keys of a file of snap-fit designs, and of one design in it."""
    from haptorb.devices.schema import list_keys
    from haptorb_study.feel.designs import DesignFile, DesignTable

    return [
        KeySection("The file", tuple(list_keys(DesignFile))),
        KeySection("[common] and each [design.NAME]", tuple(list_keys(DesignTable, "design.NAME."))),
    ]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    FILES["feel"] = FileKeys("snap-fit designs that are felt: haptorb feel FILE", list_feel_sections)
    app.command()(feel)


def feel(
    designs: Annotated[Path | None, typer.Argument(help="TOML file of candidate designs.")] = None,
    world: Annotated[
        list[str] | None, typer.Option(help="Instead of a file: a world of your own, FILE.py:NAME; repeatable.")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help='World parameter of --world, NAME=VALUE or NAME="VALUE UNIT"; repeatable.'),
    ] = None,
    device: Annotated[str, typer.Argument(help="Spherical motor: device name, or path of a device file.")] = "pmsm",
    only: Annotated[list[str] | None, typer.Option(help="Render only this design; repeatable.")] = None,
    session: Annotated[Path | None, typer.Option(help="Folder for ratings and traces (default: FILE-session).")] = None,
    person: Annotated[str, typer.Option(help="Code of the person who rates.")] = "",
    blind: Annotated[
        bool, typer.Option("--blind", help="Hide names, sizes, pictures and forces of the designs in the console.")
    ] = False,
    rate: Annotated[list[str] | None, typer.Option(help="Enter a score, NAME=1…7; repeatable.")] = None,
    choose: Annotated[str | None, typer.Option(help="Record this design as the choice.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Plot the comparison to this PNG, SVG or PDF file.")] = None,
    headless: Annotated[
        bool, typer.Option("--headless", help="Run without the console; a simulated hand moves the handle.")
    ] = False,
    duration: Annotated[
        float, typer.Option("--duration", "--seconds", help="Duration per design without the console [s].")
    ] = 15.0,
    port: Annotated[int, typer.Option(help="Port of the console; 0 takes any free port.")] = 8765,
    host: HostOption = "127.0.0.1",
    address: AddressOption = "",
    browser: Annotated[bool, typer.Option("--open", help="Open the console in the browser.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the comparison as JSON.")] = False,
) -> None:
    """Feel designs, rate each from 1 to 7, and compare them. Writes a report at the end."""
    from haptorb.runtime.linux import describe_timing
    from haptorb.web.server import PageAddress
    from haptorb_study.feel import FeelSession
    from haptorb_study.feel.limits import DesignChoice
    from haptorb_study.feel.live_session import LiveSession
    from haptorb_study.feel.report import write_report
    from haptorb_study.feel.session import check_person
    from haptorb_study.feel.trace import FELT

    if timing := describe_timing():
        notify(timing)
    where = PageAddress(host, address)
    choice = DesignChoice.of(designs, world or [], settings or [])
    candidates = choice.load()
    wanted = [candidates[name] for name in dict.fromkeys(only)] if only else list(candidates.designs)
    scores = _scores(rate or [], candidates)
    if choose is not None:
        candidates[choose]  # refuse unknown names before anything is rendered
    if not 0 < duration < float("inf"):
        raise InputError(f"--duration must be greater than 0 s; got {duration:g} s")
    if plot is not None:
        check_figure_file(plot, "--plot")
    check_person(person)
    motor, scale = find_scale(device, wanted, candidates)
    store = FeelSession(session or choice.folder, candidates)
    check_person(person, store.people())
    for design in wanted:
        for remark in design.remarks:
            notify(f"{design.name}: {remark}")
    notify(f"True scale: {scale.sentence}.")
    number = 0
    if headless:
        for design in wanted:
            feel_without_console(store, design, device, duration, person, scores.pop(design.name, None))
    else:
        live = LiveSession(store, wanted, person=person, blind=blind, limits=scale.unknown_limits)
        number = feel_with_console(live, choice, device, scale, port, browser, where)
    unfelt = [name for name in scores if not store.was_felt(name)]
    for name, score in scores.items():
        if name in unfelt:
            notify(f"{name}: not rated, for it has not been felt ({FELT})")
        else:
            store.rate(name, score, person=person)
    if choose is not None:
        store.choose(choose, person=person)
    facts = (f"Simulated device '{motor.name}': no hardware was driven.", f"True scale: {scale.sentence}.")
    notify(f"report: {write_report(store, store.folder / 'report.html', facts)}")
    _compare(candidates, store, plot, json)
    if number or unfelt:
        raise typer.Exit(128 + number if number else 1)


def _scores(given: list[str], candidates: Candidates) -> dict[str, int]:
    scores = {}
    for item in given:
        name, equals, text = item.partition("=")
        if not equals or not re.fullmatch("0|[1-9][0-9]{0,8}", text):
            raise InputError(f"--rate must be NAME=SCORE with a whole number from 1 to 7; got '{item}'")
        scores[candidates[name].name] = int(text)
    from haptorb_study.feel.session import SCORES

    low, high = SCORES
    for name, score in scores.items():
        if not low <= score <= high:
            raise InputError(f"--rate {name}: a score must be a whole number from {low} to {high}; got {score}")
    return scores


def _compare(candidates: Candidates, session: FeelSession, plot: Path | None, json: bool) -> None:
    from haptorb_study.feel.comparison import comparison, plot_comparison

    table = comparison(candidates, session)
    if plot is not None:
        plot_comparison(candidates, plot, session)
        notify(f"drawn: {plot}")
    if json:
        tidy = {
            name: {key: None if value != value else value for key, value in row.items()} for name, row in table.items()
        }
        print_json(tidy)
        return
    shown = TextTable(
        (Column("design", kind="key"), Column("insert", "N"), Column("pull out", "N"), Column("strain", "%"),
         Column("ratings"), Column("score", "1 to 7"), Column("choice")),
    )  # fmt: skip
    for name, row in table.items():
        shown.add_row(
            name, f"{row['insertion_force_n']:.1f}", f"{row['pull_out_force_n']:.1f}",
            f"{1e2 * row['root_strain']:.2f}" if "root_strain" in row else "-",
            str(row["ratings"]), f"{row['score']:.1f}" if row["ratings"] else "", "chosen" if row["chosen"] else "",
        )  # fmt: skip
    print_table(make_console(), shown)


# --------------------------------------------------------------------------------------------------
# Feel session with its servo: with console and terminal, or with a simulated hand only.


_POLL_INTERVAL_S = 0.05  #: polling interval of the servo's rows [s]


def find_scale(device: str, designs: Sequence[Candidate], candidates: Candidates) -> tuple[Device, TrueScale]:
    """The device, and the scale from a force on the part to the hand.

    Raises InputError if it has no handle, or cannot render one of `designs`.
    """
    from haptorb.control.linkage import MOTOR_GAINS
    from haptorb.devices.loader import load
    from haptorb.worlds.user_world import try_world
    from haptorb_study.feel.torque_scale import TrueScale

    motor = load(device)
    scale = TrueScale.of(motor, MOTOR_GAINS.scale(float(candidates.gains.torque_per_motion[0])))
    for design in designs:
        try_world(design.world, motor)
    return motor, scale


def _servo(device: str, design: Candidate, candidates: Candidates, *, record: Literal[False] | None = None) -> Servo:
    from haptorb.control.linkage import MOTOR_GAINS
    from haptorb.runtime.config import RunConfig
    from haptorb.runtime.servo import Servo

    # The file scales torques; the ratio of handle to part motion belongs to the motor.
    gains = MOTOR_GAINS.scale(float(candidates.gains.torque_per_motion[0]))
    return Servo(RunConfig.of(device, design.world, gains=gains), record=record)


def feel_without_console(
    store: FeelSession, design: Candidate, device: str, seconds: float, person: str, score: int | None
) -> None:
    """Let a simulated hand pull `design` out and push it back; store the trace, and `score` if given."""
    from haptorb_study.feel.trace import Trace, trace_rows

    servo = _servo(device, design, store.candidates)
    with queue_output(), servo:
        servo.run(seconds)
    trace = Trace(design)
    recording = servo.recording
    trace.extend(trace_rows(servo.layout, recording.rows))
    name = store.store_trace(trace, person=person) if len(trace) else ""
    if score is not None:
        store.rate(design.name, score, person=person, trace=name)
    notify(f"{design.title}: rendered for {len(trace) * 1e-3:.1f} s" + (f", rated {score}" if score else ""))


def feel_with_console(
    live: LiveSession, choice: DesignChoice, device: str, scale: TrueScale, port: int, browser: bool, where: PageAddress
) -> int:
    """Run the session with page and terminal until it is finished; returns the signal's number, or 0."""
    from haptorb.runtime.linux import run_uninterrupted
    from haptorb.runtime.world_requests import name_of
    from haptorb.web.console import Console
    from haptorb.web.server import freeze_garbage
    from haptorb.web.session import object_scene
    from haptorb.worlds.base import values as parameter_values
    from haptorb_study.feel.live_session import HELP, FeelPanel, read_lines, wait_for_lines, world_key

    for design in live.designs:  # computed before the servo starts, so that the hand does not wait
        object_scene(name_of(design.world), parameter_values(design.world))
    servo = _servo(device, live.current, live.candidates, record=False)
    for number, design in enumerate(live.designs):
        servo.add_world(design.world, world_key(number))
    ended = Event()

    def collect() -> None:
        while not ended.wait(_POLL_INTERVAL_S):
            live.collect()

    def listen() -> None:
        with suppress(OSError, ValueError):  # no standard input
            read_lines(live, wait_for_lines(sys.stdin.fileno(), ended.is_set), notify)

    check = StabilityCheck(choice, device, [design.name for design in live.designs])

    def judge() -> None:
        margin = check.wait()
        if not ended.is_set():
            live.set_limits(find_limits(scale, live.designs, margin))

    threads = [Thread(target=work, name=f"haptorb-{work.__name__}") for work in (collect, listen, judge)]

    def end(_: Event) -> None:  # a second Ctrl-C must not lose the last trace
        servo.end_loop()
        ended.set()
        check.close()
        for thread in threads:
            thread.join()
        live.collect()

    if where.warning:
        notify(where.warning)
    try:
        with (
            queue_output(),
            Console(servo, port, designs=FeelPanel(live), where=where) as console,
            freeze_garbage(),
            servo,
        ):
            live.attach(servo)
            live.notify = notify
            notify(f"Open {console.url} in a browser. Ctrl-C ends.\n{HELP}\nnow: {live.label}")
            for thread in threads:
                thread.start()
            try:
                ended_by = console.serve(open_browser=browser, until=lambda: live.finished)
                servo.check_end()
            finally:
                run_uninterrupted(end)
    finally:
        run_uninterrupted(lambda _: live.close())
    return ended_by or 0
