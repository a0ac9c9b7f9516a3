"""`haptorb check`: checks whether this computer is fast enough for the loop, and whether a world is rendered stably."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptorb.errors import InputError
from haptorb.figure_file import check_figure_file
from haptorb.terminal import echo, make_console, make_progress, print_facts, print_json

if TYPE_CHECKING:
    from haptorb.cli.check_world import Setting, WorldVerdict
    from haptorb.devices.base import Device

__all__ = ["judge_scene", "register"]


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
    from haptorb.runtime.linux import require_linux

    require_linux("`haptorb check` of the computer")
    from haptorb.cli.check_computer import measure_fitness, print_fitness

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

    from haptorb.analysis.stability import check_grip
    from haptorb.cli.check_world import Setting
    from haptorb.runtime.clock import check_rate

    if not (isfinite(latency) and latency >= 0):
        raise InputError(f"--latency must be at least 0 ms; got {latency:g} ms")
    if tracker_rate is not None and not (isfinite(tracker_rate) and tracker_rate > 0):
        raise InputError(f"--tracker-rate must be above 0 Hz; got {tracker_rate:g} Hz")
    bandwidth = _bandwidth(device, tracker, tracker_rate)
    return Setting(check_rate(rate), tracker_rate, 1e-3 * latency, grip, check_grip(grip), bandwidth)


def _judge(
    device: Device, world: str, settings: list[str], setting: Setting, plot: Path | None, json: bool, render: str | None
) -> None:
    from haptorb.cli.check_world import draw_world, judge_world, print_world
    from haptorb.cli.world_option import choose_world_option
    from haptorb.worlds.user_world import WorldFile

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
    """Return the bandwidth of the filter behind `tracker` [Hz]; None without a filter."""
    from haptorb.devices.api import electromagnet
    from haptorb.estimation.hall_tracker import HallTracker
    from haptorb.estimation.registry import check_estimator

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
    """Return (damping, largest stiffness) of the simulated loop for some hands; empty if it cannot be simulated."""
    from dataclasses import replace

    from haptorb.cli.check_world import boundary

    if verdict.part == "torque":  # the test springs render forces only
        return []
    setting, found = verdict.setting, []
    with make_progress() as bar:
        for damping in bar.track((0.5, 1.0, 2.0, 5.0, 10.0), description="testing stiffness"):
            hand = replace(setting.hand, damping=damping)
            expected = verdict.loop.largest(verdict.place.grip(hand))
            hall = setting.bandwidth is not None
            largest = boundary(device, hand, expected, setting.rate, setting.tracker_rate, setting.latency, hall=hall)
            if largest is None:
                return []
            found.append((damping, largest))
    return found


# --------------------------------------------------------------------------------------------------
# `haptorb check --scene`: stability margin of the coupling for a loop and a hand.


def judge_scene(
    device: Device, scene: str | None, body: str | None, world: str | None, settings: list[str], setting: Setting,
    json: bool,
) -> bool:  # fmt: skip
    """Print the coupling of `scene` on `device` under `setting`; return whether it is stable against a wall.

    Raises UnknownName and InputError for an invalid scene, body or value.
    """
    from haptorb.analysis.coupling import couple_world, measure_margin
    from haptorb.analysis.stability import MIN_STABILITY_MARGIN
    from haptorb.cli.world_option import choose_scene_option
    from haptorb.display import format_number
    from haptorb.worlds.scene import Scene

    found = choose_scene_option(scene, body, world, settings, device).load()
    loop = setting.loop(device)
    chosen = couple_world(found, device, loop, setting.hand)
    assert isinstance(chosen, Scene)
    coupled = chosen.for_device(device)
    margin = measure_margin(coupled, device, loop, setting.hand)
    verdict = "inside" if margin >= MIN_STABILITY_MARGIN else ("close" if margin > 1.0 else "outside")
    numbers = {
        "device": device.name, "scene": coupled.model.title, "body": coupled.body, "verdict": verdict,
        "margin": margin, "chosen": not found.stiffness, "stiffness_n_per_m": coupled.stiffness,
        "damping_n_s_per_m": coupled.damping, "turn_stiffness_nm_per_rad": coupled.turn_stiffness,
        "turn_damping_nm_s_per_rad": coupled.turn_damping, "rate_hz": setting.rate, "latency_s": setting.latency,
        "grip": setting.grip,
    }  # fmt: skip
    if json:
        print_json(numbers)
        return margin > 1.0
    facts = [
        ("coupling", f"{coupled.stiffness:.4g} N/m, {coupled.damping:.3g} N·s/m"),
        ("chosen", "for this loop and hand" if not found.stiffness else "given"),
        ("against a wall", f"{verdict}: stable up to {format_number(margin)} times that"),
        ("loop", f"{setting.rate:g} Hz, forces {1e3 * loop.lateness:.2f} ms late, grip {setting.grip}"),
    ]
    if coupled.turn_stiffness:
        facts.insert(1, ("in turning", f"{coupled.turn_stiffness:.3g} N·m/rad, {coupled.turn_damping:.2g} N·m·s/rad"))
    echo(f"{device.name}, scene '{coupled.model.title}', body '{coupled.body}'")
    print_facts(make_console(), facts)
    return margin > 1.0
