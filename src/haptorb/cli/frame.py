"""`haptorb frame`: register a tracker's frame and rigid body by touching the device, and write the frame file."""

from __future__ import annotations

import math
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptorb.errors import InputError
from haptorb.terminal import echo, notify, print_json

if TYPE_CHECKING:
    from haptorb.cli.frame_dialog import Stroke

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(frame)


def frame(
    device: Annotated[str, typer.Argument(help="Device name, or path of a device file.")] = "omni",
    tracker: Annotated[
        str,
        typer.Option(
            help="Tracker with its own frame: osc:PORT, osc:HOST:PORT, lsl:NAME[/SOURCE], natnet:HOST[:PORT][/BODY]."
        ),
    ] = "osc:9000",
    out: Annotated[Path | None, typer.Option(help="File to write (default: DEVICE.frame.json).")] = None,
    rehearse: Annotated[
        bool,
        typer.Option("--rehearse", help="Rehearse with a simulated tracker and person, through OSC on this computer."),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of the rehearsal.")] = 0,
    json: Annotated[bool, typer.Option("--json", help="Print the frame as JSON.")] = False,
) -> None:
    """Register a tracker's frame: touch the dome and its marks, roll the tool. Then use haptorb run --frame FILE."""
    from haptorb.cli.frame_dialog import (
        TIME_SCALE,
        Rehearsal,
        check_device,
        measure_miss,
        register_frame,
        rehearsal_port,
    )
    from haptorb.cli.progress import time_bar
    from haptorb.devices.loader import load
    from haptorb.estimation.calibration_file import check_writable, write_frame
    from haptorb.estimation.tracker_frame import TrackerFrame
    from haptorb.runtime.trackers.registry import check_tracker, feed_of, has_feed, prepare_tracker

    found = check_device(load(device))
    check_tracker(tracker)
    if not has_feed(tracker) or tracker.startswith("replay:"):
        raise InputError(
            f"tracker '{tracker}' already reports poses in the stator's frame; name a tracker with its own frame"
        )
    port = rehearsal_port(tracker) if rehearse else 0
    path = check_writable(out or Path(f"{found.name}.frame.json"), overwrite=force)
    if not rehearse and not sys.stdin.isatty():
        raise InputError(
            "registering a frame prompts before every step, and there is no terminal: run it in a terminal"
        )
    preparation = prepare_tracker(tracker)
    rehearsal = Rehearsal(found, port, seed) if rehearse else None
    opened, doing = ExitStack(), ExitStack()

    def prompt(stroke: Stroke) -> bool:
        if rehearsal is None:
            return typer.confirm("    ready", default=True, err=True)
        doing.close()  # of the previous stroke
        doing.enter_context(rehearsal.send_stroke(stroke))
        return True

    with opened, doing:
        if preparation.token:
            notify(f"A program on another computer must send this token before its poses: {preparation.token}")
        feed = feed_of(preparation.spec, preparation.descriptor, lambda: 0.0)
        preparation.descriptor = -1  # owned by the feed from here on
        opened.callback(feed.close)
        result = register_frame(
            found, feed, prompt=prompt, notify=notify, bar=time_bar, pace=TIME_SCALE if rehearse else 1.0
        )
    if result is None:
        raise typer.Exit(1)
    written = TrackerFrame.of(result, found, found.tool.tip_distance, tracker, simulated=rehearse)
    write_frame(written, path, overwrite=force)
    if json:
        from json import loads

        print_json(loads(written.text()))
        return
    left_out = f"; {result.excluded} excluded (tip off the dome)" if result.excluded else ""
    echo(f"{result.used} touches, residual {1e3 * result.residual:.2f} mm rms{left_out}; condition "
         f"{result.condition:.1f}")  # fmt: skip
    echo(f"expected accuracy {1e3 * result.position:.2f} mm and {math.degrees(result.direction):.2f}°; fitted dome "
         f"radius {1e3 * result.radius:.2f} mm (device file: {1e3 * found.dome_radius:g} mm); axis wobble "
         f"{math.degrees(result.wobble):.2f}°")  # fmt: skip
    if rehearsal is not None:
        place, turn = measure_miss(result, rehearsal.tracker, found)
        echo(f"error against the simulated truth: {1e3 * place:.2f} mm rms, {math.degrees(turn):.2f}° at most")
    echo(f"written: {path}{' (rehearsal)' if rehearse else ''}; use it with: "
         f"haptorb run {device} --tracker {tracker} --frame {path}")  # fmt: skip
