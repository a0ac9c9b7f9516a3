"""`haptorb check`: is this computer fit for a real-time loop, and is a world inside what a loop can render?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptorb.apps.figure_file import check_figure_file
from haptorb.apps.terminal import make_progress, print_json
from haptorb.errors import InputError

if TYPE_CHECKING:
    from haptorb.apps.check import Setting, WorldVerdict
    from haptorb.devices.device import Device

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(check)


def check(
    device: Annotated[
        str,
        typer.Argument(help="Device name, or path of a device file; the computer is measured with a simulated device."),
    ] = "omni",
    duration: Annotated[float, typer.Option(help="Duration of the measurement of the computer [s].")] = 30.0,
    rate: Annotated[float, typer.Option(help="Loop rate [Hz], 50 to 4000.")] = 1000.0,
    alone: Annotated[
        bool, typer.Option("--alone", help="Measure without a client that drags the tool and reads at 60 Hz.")
    ] = False,
    world: Annotated[
        str | None,
        typer.Option(help="World whose stability to check, instead of the computer: a name, or your own FILE.py:NAME."),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(help="MuJoCo scene whose coupling to check against a wall: a supplied one, or FILE.xml."),
    ] = None,
    body: Annotated[
        str | None, typer.Option(help="With --scene: body to hold (default: the one that the scene names).")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help='World parameter, NAME=VALUE, NAME="VALUE UNIT" or NAME=X,Y,Z; repeatable.'),
    ] = None,
    render: Annotated[
        str | None, typer.Option(help="With --world: part of the wrench to render: force, torque, both.")
    ] = None,
    tracker: Annotated[
        str | None, typer.Option(help="With --world: hall (field sensors with their filter), or hall:HZ.")
    ] = None,
    tracker_rate: Annotated[
        float | None, typer.Option(help="Tracker rate [Hz] (default: a pose in every tick).")
    ] = None,
    latency: Annotated[float, typer.Option(help="Latency of the tracker [ms].")] = 0.0,
    grip: Annotated[
        str, typer.Option(help="Grip of the hand: loose, light, firm, or MASS,DAMPING,STIFFNESS in kg, N·s/m, N/m.")
    ] = "light",
    plot: Annotated[
        Path | None, typer.Option(help="With --world: plot the Z-width to this PNG, SVG or PDF file.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check whether this computer is fast enough for the loop or, with --world or --scene, whether the loop is stable.

    Exit code 1: it is not.
    """
    if scene is not None or body is not None:
        from haptorb.apps.cli.check_scene import judge_scene
        from haptorb.devices.loader import load

        found = load(device)
        setting = _setting(found, rate, tracker, tracker_rate, latency, grip)
        if not judge_scene(found, scene, body, world, settings or [], setting, json):
            raise typer.Exit(1)
        return
    if world is not None:
        if plot is not None:
            check_figure_file(plot, "--plot")
        from haptorb.devices.loader import load

        found = load(device)
        _judge(
            found,
            world,
            settings or [],
            _setting(found, rate, tracker, tracker_rate, latency, grip),
            plot,
            json,
            render,
        )
        return
    if plot is not None or settings or tracker is not None or tracker_rate is not None or latency or render:
        raise InputError(
            "--plot, --set, --render, --tracker, --tracker-rate and --latency are for a world or scene: give "
            "--world or --scene as well, such as --world dome"
        )
    from haptorb.runtime.realtime.linux import require_linux

    require_linux("`haptorb check` of the computer")
    from haptorb.apps.check import measure_fitness, print_fitness

    result = measure_fitness(duration, rate=rate, device=device, dragging=not alone)
    if json:
        print_json(result.numbers())
    else:
        print_fitness(result)
    if not result.fit:
        raise typer.Exit(1)


def _setting(
    device: Device, rate: float, tracker: str | None, tracker_rate: float | None, latency: float, grip: str
) -> Setting:
    from math import isfinite

    from haptorb.apps.check import Setting
    from haptorb.control.stability.hand_grip import check_grip
    from haptorb.runtime.realtime.schedule import check_rate

    if not (isfinite(latency) and latency >= 0):
        raise InputError(f"--latency must be at least 0 ms; got {latency:g} ms")
    if tracker_rate is not None and not (isfinite(tracker_rate) and tracker_rate > 0):
        raise InputError(f"--tracker-rate must be above 0 Hz; got {tracker_rate:g} Hz")
    bandwidth = _bandwidth(device, tracker, tracker_rate)
    return Setting(check_rate(rate), tracker_rate, 1e-3 * latency, grip, check_grip(grip), bandwidth)


def _judge(
    device: Device, world: str, settings: list[str], setting: Setting, plot: Path | None, json: bool, render: str | None
) -> None:
    from haptorb.apps.check import draw_world, judge_world, print_world
    from haptorb.apps.cli.world_option import choose_world_option
    from haptorb.worlds.own.world_file import WorldFile

    chosen = choose_world_option(world, settings, device)
    verdict = judge_world(device, chosen.load() if isinstance(chosen, WorldFile) else chosen, setting, world, render)
    if json:
        print_json(verdict.numbers())
    else:
        print_world(verdict)
    if plot is not None:
        draw_world(verdict, plot, _try_hands(device, verdict))
    if not verdict.fit:
        raise typer.Exit(1)


def _bandwidth(device: Device, tracker: str | None, tracker_rate: float | None) -> float | None:
    """Of the filter behind `tracker` [Hz]; None where there is none."""
    from haptorb.devices.electromagnet.api import electromagnet
    from haptorb.runtime.tick.assembly import check_estimator
    from haptorb.sensing.tool.tool_position import HallTracker

    if tracker is None:
        return None
    name, _, bandwidth = tracker.partition(":")
    if name != "hall" or (bandwidth and not bandwidth.replace(".", "", 1).isdecimal()):
        raise InputError(
            f"--tracker must be hall or hall:HZ; for others give --tracker-rate and --latency; got '{tracker}'"
        )
    check_estimator(device, name)
    if tracker_rate is not None:
        raise InputError("--tracker hall measures a pose in every tick: leave out --tracker-rate")
    found = electromagnet(device, "--tracker hall")
    return (HallTracker(found, bandwidth=float(bandwidth)) if bandwidth else HallTracker(found)).bandwidth


def _try_hands(device: Device, verdict: WorldVerdict) -> list[tuple[float, float]]:
    """(damping, largest stiffness) of the whole simulated chain for a few hands; none where its kind has none."""
    from dataclasses import replace

    boundary = device.kind.part("boundary")
    if boundary is None or verdict.part == "torque":  # its springs push, they do not turn
        return []
    setting, found = verdict.setting, []
    with make_progress() as bar:
        for damping in bar.track((0.5, 1.0, 2.0, 5.0, 10.0), description="testing stiffness"):
            hand = replace(setting.hand, damping=damping)
            expected = verdict.loop.largest(verdict.place.grip(hand))
            hall = setting.bandwidth is not None
            largest = boundary(device, hand, expected, setting.rate, setting.tracker_rate, setting.latency, hall=hall)
            found.append((damping, largest))
    return found
