"""`haptorb feel`: candidate designs from a file, felt one after another, rated, compared: Bai 2012, Fig. 5(a)."""

from __future__ import annotations

from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Annotated

import typer

from haptorb.apps.figure_file import check_figure_file
from haptorb.apps.terminal import Column, TextTable, make_console, print_json, print_table, say
from haptorb.errors import InputError

if TYPE_CHECKING:
    from haptorb.apps.feel import Candidate, Candidates, FeelSession, Trace
    from haptorb.runtime.recording.recording import Recording
    from haptorb.runtime.servo.servo import Servo

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(feel)


def feel(
    designs: Annotated[Path, typer.Argument(help="TOML file of candidate designs.")],
    device: Annotated[str, typer.Argument(help="Spherical motor: device name, or path of a device file.")] = "pmsm",
    only: Annotated[list[str] | None, typer.Option(help="Render only this design; repeatable.")] = None,
    session: Annotated[Path | None, typer.Option(help="Folder for ratings and traces (default: FILE-session).")] = None,
    person: Annotated[str, typer.Option(help="Code of the person who rates.")] = "",
    rate: Annotated[list[str] | None, typer.Option(help="Enter a score, NAME=1…7; repeatable.")] = None,
    choose: Annotated[str | None, typer.Option(help="Record this design as the choice.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Draw the comparison into this PNG, SVG or PDF file.")] = None,
    headless: Annotated[
        bool, typer.Option("--headless", help="Run without the console; a simulated hand moves the handle.")
    ] = False,
    seconds: Annotated[float, typer.Option(help="Duration per design without the console [s].")] = 15.0,
    port: Annotated[int, typer.Option(help="Port of the console; 0 takes any free port.")] = 8765,
    json: Annotated[bool, typer.Option("--json", help="Print the comparison as JSON.")] = False,
) -> None:
    """Feel designs one after another, rate each from 1 to 7, and compare them. Traces and ratings are stored."""
    from haptorb.apps.feel import FeelSession, load_designs
    from haptorb.runtime.realtime.linux import require_linux

    require_linux("`haptorb feel`")
    candidates = load_designs(designs)
    wanted = [candidates[name] for name in only] if only else list(candidates.designs)
    scores = _scores(rate or [], candidates)
    if choose is not None:
        candidates[choose]  # refuses a name that there is not before anything is felt
    if not 0 < seconds < float("inf"):
        raise InputError(f"--seconds must be greater than 0; got {seconds:g}")
    if plot is not None:
        check_figure_file(plot, "--plot")
    store = FeelSession(session or designs.with_name(f"{designs.stem}-session"), candidates)
    for design in wanted:
        for remark in design.remarks:
            say(f"{design.name}: {remark}")
        servo = _servo(device, design, candidates)
        answer = _run_without_console(servo, seconds) if headless else _run_with_console(servo, design, port)
        trace = _trace(servo.recording, design)
        name = store.keep(trace) if len(trace.rows) else ""
        score = scores.get(design.name, _score(answer))
        if score is not None:
            store.rate(design.name, score, person=person, trace=name)
        say(f"{design.title}: rendered for {len(trace.rows) * 1e-3:.1f} s" + (f", rated {score}" if score else ""))
    if choose is not None:
        store.choose(choose, person=person)
    _compare(candidates, store, plot, json)


def _servo(device: str, design: Candidate, candidates: Candidates) -> Servo:
    from haptorb.control.clutch.linkage import MOTOR_GAINS
    from haptorb.runtime.servo.servo import Servo

    # The file scales torques; how far the handle moves the part is the motor's matter.
    return Servo(device, design.world, gains=MOTOR_GAINS.scale(float(candidates.gains.torque_per_motion[0])))


def _run_without_console(servo: Servo, seconds: float) -> str:
    with servo:
        servo.run(seconds)
    return ""


def _run_with_console(servo: Servo, design: Candidate, port: int) -> str:
    """What the person typed after feeling `design` in the browser."""
    from haptorb.apps.console import Console

    done, message = Event(), [""]

    def ask() -> None:
        try:
            message[0] = input(f"{design.title}: type a score from 1 to 7 and press Enter (Enter alone: no score): ")
        except EOFError:
            return
        done.set()

    with Console(servo, port) as console, servo:
        say(f"Open {console.url} in a browser. Ctrl-C ends.")
        Thread(target=ask, daemon=True).start()
        number = console.serve(open_browser=False, until=done.is_set)
        servo.check()
    if number:
        raise typer.Exit(128 + number)
    return message[0]


def _trace(recording: Recording, design: Candidate) -> Trace:
    """What the part went through, tick by tick."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    from haptorb.apps.feel import Trace
    from haptorb.devices.state import State

    trace = Trace(design)
    believed = recording["valid"] > 0
    p, q, wrench = (recording[name][believed] for name in ("object", "object_q", "object_wrench"))
    if not len(p):
        return trace
    zero = np.zeros(3)
    turns = Rotation.from_quat(q).as_matrix()
    for t, place, R, push in zip(recording.t[believed].tolist(), p, turns, wrench, strict=True):
        trace.append(State(t, R, place, zero, zero), push)
    return trace


def _score(answer: str) -> int | None:
    text = answer.strip()
    if not text:
        return None
    if not text.isdecimal():
        raise InputError(f"a score must be a whole number from 1 to 7; got '{text}'")
    return int(text)


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
