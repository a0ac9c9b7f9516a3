"""`haptorb feel`: candidate designs from a file, felt one after another, rated, compared: Bai 2012, Fig. 5(a)."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from haptorb.apps.terminal import Column, TextTable, make_console, print_json, print_table, say
from haptorb.errors import InputError

if TYPE_CHECKING:
    from haptorb.apps.feel import Candidate, Candidates, FeelSession
    from haptorb.apps.feel.live_session import LiveSession
    from haptorb.runtime.servo.servo import Servo

__all__ = ["register"]

_EVERY = 0.05  #: between two looks at the servo's rows [s]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(feel)


def feel(
    designs: Annotated[Path, typer.Argument(help="TOML file of candidate designs.")],
    device: Annotated[str, typer.Option(help="Spherical motor: device name, or path of a device file.")] = "pmsm",
    only: Annotated[list[str] | None, typer.Option(help="Render only this design; repeatable.")] = None,
    session: Annotated[Path | None, typer.Option(help="Folder for ratings and traces (default: FILE-session).")] = None,
    person: Annotated[str, typer.Option(help="Code of the person who rates.")] = "",
    blind: Annotated[
        bool, typer.Option("--blind", help="Hide names, sizes, pictures and forces of the designs in the console.")
    ] = False,
    rate: Annotated[list[str] | None, typer.Option(help="Enter a score, NAME=1…7; repeatable.")] = None,
    choose: Annotated[str | None, typer.Option(help="Record this design as the choice.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the comparison into this PNG or SVG file.")] = None,
    headless: Annotated[
        bool, typer.Option("--headless", help="Run without the console; a simulated hand moves the handle.")
    ] = False,
    seconds: Annotated[float, typer.Option(help="Duration per design without the console [s].")] = 15.0,
    port: Annotated[int, typer.Option(help="Port of the console; 0 takes any free port.")] = 8765,
    browser: Annotated[bool, typer.Option("--open", help="Open the console in the browser.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the comparison as JSON.")] = False,
) -> None:
    """Feel designs, rate each from 1 to 7, and compare them. At the end there is a report."""
    from haptorb.apps.feel import FeelSession, load_designs
    from haptorb.apps.feel.live_session import LiveSession
    from haptorb.apps.feel.session import check_person
    from haptorb.runtime.realtime.linux import require_linux

    require_linux("`haptorb feel`")
    candidates = load_designs(designs)
    wanted = [candidates[name] for name in dict.fromkeys(only)] if only else list(candidates.designs)
    scores = _scores(rate or [], candidates)
    if choose is not None:
        candidates[choose]  # refuses a name that there is not before anything is felt
    if not 0 < seconds < float("inf"):
        raise InputError(f"--seconds must be greater than 0; got {seconds:g}")
    if plot is not None and (plot.suffix not in (".png", ".svg") or not plot.parent.is_dir()):
        raise InputError(f"--plot must be a .png or .svg file in an existing folder; got '{plot}'")
    person = check_person(person)
    kept = FeelSession(session or designs.with_name(f"{designs.stem}-session"), candidates)
    for design in wanted:
        for remark in design.remarks:
            say(f"{design.name}: {remark}")
    number = 0
    if headless:
        for design in wanted:
            _feel_without_console(kept, design, device, seconds, person, scores.pop(design.name, None))
    else:
        live = LiveSession(kept, wanted, person=person, blind=blind)
        number = _feel_with_console(live, device, candidates, port, browser)
    for name, score in scores.items():
        kept.rate(name, score, person=person)
    if choose is not None:
        kept.choose(choose, person=person)
    _compare(candidates, kept, plot, json)
    if number:
        raise typer.Exit(128 + number)


def _servo(device: str, design: Candidate, candidates: Candidates, *, record: Literal[False] | None = None) -> Servo:
    from haptorb.control.clutch.linkage import MOTOR_GAINS
    from haptorb.runtime.servo.servo import Servo

    # The file scales torques; how far the handle moves the part is the motor's matter.
    gains = MOTOR_GAINS.scale(float(candidates.gains.torque_per_motion[0]))
    return Servo(device, design.world, gains=gains, record=record)


def _feel_without_console(
    kept: FeelSession, design: Candidate, device: str, seconds: float, person: str, score: int | None
) -> None:
    """A simulated hand pulls `design` out and puts it back; its trace is kept, and `score` if there is one."""
    from haptorb.apps.feel.trace import Trace, trace_rows

    servo = _servo(device, design, kept.candidates)
    with servo:
        servo.run(seconds)
    trace = Trace(design)
    recording = servo.recording
    trace.extend(trace_rows(servo.layout, recording.rows))
    name = kept.keep(trace, person=person) if len(trace) else ""
    if score is not None:
        kept.rate(design.name, score, person=person, trace=name)
    say(f"{design.title}: rendered for {len(trace) * 1e-3:.1f} s" + (f", rated {score}" if score else ""))


def _feel_with_console(live: LiveSession, device: str, candidates: Candidates, port: int, browser: bool) -> int:
    """Designs felt and rated in page and terminal until somebody finishes; the signal's number, or 0."""
    from haptorb.apps.console import Console
    from haptorb.apps.console.target import target_scene
    from haptorb.apps.feel.live_session import world_key
    from haptorb.apps.feel.terminal_input import HELP, read_lines, wait_for_lines
    from haptorb.apps.web.server import freeze_garbage
    from haptorb.runtime.exchange.world_change import name_of
    from haptorb.worlds.parameter import values as parameter_values

    for design in live.designs:  # computed now: while the servo runs, a hand would wait for it
        target_scene(name_of(design.world), parameter_values(design.world))
    servo = _servo(device, live.current, candidates, record=False)
    for number, design in enumerate(live.designs):
        servo.add_world(design.world, world_key(number))
    ended = Event()

    def collect() -> None:
        while not ended.wait(_EVERY):
            live.collect()

    def listen() -> None:
        with suppress(OSError, ValueError):  # no standard input at all
            read_lines(live, wait_for_lines(sys.stdin.fileno(), ended.is_set), say)

    threads = [Thread(target=collect, name="haptorb-traces"), Thread(target=listen, name="haptorb-terminal")]
    with Console(servo, port, designs=live) as console, freeze_garbage(), servo:
        live.join(servo)
        live.news = say
        say(f"Open {console.url} in a browser. Ctrl-C ends.\n{HELP}\nnow: {live.label}")
        for thread in threads:
            thread.start()
        try:
            number = console.serve(open_browser=browser, until=lambda: live.finished)
            servo.check()
        finally:
            ended.set()
            for thread in threads:
                thread.join()
            live.collect()
    live.close()
    return number or 0


def _scores(given: list[str], candidates: Candidates) -> dict[str, int]:
    scores = {}
    for item in given:
        name, equals, text = item.partition("=")
        if not equals or not text.strip().isdecimal():
            raise InputError(f"--rate must be NAME=SCORE with a whole number from 1 to 7; got '{item}'")
        scores[candidates[name].name] = int(text)
    from haptorb.apps.feel.session import SCORES

    low, high = SCORES
    for name, score in scores.items():
        if not low <= score <= high:
            raise InputError(f"--rate {name}: a score must be a whole number from {low} to {high}; got {score}")
    return scores


def _compare(candidates: Candidates, session: FeelSession, plot: Path | None, json: bool) -> None:
    from haptorb.apps.feel.comparison import comparison, plot_comparison

    table = comparison(candidates, session)
    if plot is not None:
        plot_comparison(candidates, plot, session)
        say(f"drawn: {plot}")
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
            f"{1e2 * row['root_strain']:.2f}",
            str(row["ratings"]), f"{row['score']:.1f}" if row["ratings"] else "", "chosen" if row["chosen"] else "",
        )  # fmt: skip
    print_table(make_console(), shown)
