"""`haptorb run`: run a device with a world, and serve the console in the browser."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread, Timer
from typing import TYPE_CHECKING, Annotated, Any

import typer

from haptorb.errors import InputError
from haptorb.runtime.linux import Termination, run_uninterrupted
from haptorb.terminal import notify, print_json, queue_output

if TYPE_CHECKING:
    from haptorb.runtime.prestart import PrestartedProcess
    from haptorb.runtime.servo import Servo
    from haptorb.serve.base import Serving
    from haptorb.web.server import PageAddress
    from haptorb.worlds import World
    from haptorb.worlds.scene import SceneFile
    from haptorb.worlds.user_world import WorldFile

__all__ = [
    "AddressOption",
    "HostOption",
    "describe_tracking",
    "notify_missing_pose",
    "notify_rendered_part",
    "register",
]

#: option of every command that serves a page
HostOption = Annotated[
    str, typer.Option(help="Address to listen on; 0.0.0.0: other computers reach the page, with its token.")
]
AddressOption = Annotated[
    str, typer.Option(help="Address of the page behind a proxy, such as https://lab.example/haptorb/.")
]


# --------------------------------------------------------------------------------------------------
# Report once, on the terminal, which part of the wrench is rendered and what is left out.


_CHECK_INTERVAL_S = 0.2  #: polling interval: a world without a declared part is classified while it runs


@contextmanager
def notify_rendered_part(servo: Servo) -> Iterator[None]:
    """While the block runs, print a line when a part of the wrench is rendered for the first time."""
    from haptorb.worlds.base import PARTS

    ended, known = Event(), set[str]()

    def poll() -> None:
        while True:
            part = servo.rendered_part
            if part is not None and part not in known:
                known.add(part)
                text = servo.part_remarks[PARTS.index(part)] if part != "force" or servo.render else ""
                if text:
                    notify(text)
            if ended.wait(_CHECK_INTERVAL_S):
                return

    poller = Thread(target=poll, name="rendered part", daemon=True)
    poller.start()
    try:
        yield
    finally:
        ended.set()
        poller.join()


# --------------------------------------------------------------------------------------------------
# Report on the terminal what a servo waits for while its tracker sends no pose, and statistics of the poses at the end.


_FIRST_CHECK_S = 2.0  #: delay of the first check after the start
_REPEAT_INTERVAL_S = 10.0  #: least interval between two lines while counts change


@contextmanager
def notify_missing_pose(servo: Servo) -> Iterator[None]:
    """While the block runs, print a line 2 s after the start if no pose is valid, and again whenever its counts have
    changed, at most every 10 s."""
    ended = Event()

    def poll() -> None:
        last_text, interval = "", _FIRST_CHECK_S
        while not ended.wait(interval):
            interval = _FIRST_CHECK_S
            text = servo.missing_pose if servo.alive else ""
            if text and text != last_text:
                notify(f"{text[0].upper()}{text[1:]}")
                interval = _REPEAT_INTERVAL_S
            last_text = text

    poller = Thread(target=poll, name="missing pose", daemon=True)
    poller.start()
    try:
        yield
    finally:
        ended.set()
        poller.join()


def describe_tracking(name: str, poses: dict[str, Any]) -> str:
    """Summarise the poses of the tracker `name` in one line, from `tracking` of the run's report [Hz, ms]."""
    if not poses["accepted"]:
        text = "no pose accepted"
    else:
        text = f"{poses['accepted']} poses, {poses['rate_hz'] or 0:.0f} Hz"
        if poses["age_ms"]:
            text += f", age in use {poses['age_ms']['p50']:.1f} ms (99 %: {poses['age_ms']['p99']:.1f} ms)"
    refused = ", ".join(f"{count} {why.replace('_', ' ')}" for why, count in poses["refused"].items())
    remark = f"; {poses['remark']}" if poses.get("remark") else ""
    refused = f"; refused: {refused}" if refused else ""
    return f"tracker {name}: {text}, lost {poses['lost']} times{refused}{remark}"


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(run)


def run(
    device: Annotated[str, typer.Argument(help="Device name, or path of a device file.")] = "omni",
    world: Annotated[
        str | None,
        typer.Option(
            help="World to render, from `haptorb worlds`, or your own: FILE.py:NAME (default: dome; outlet on a motor; "
            "with --serve haply or native the programs' force alone, remote)."
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help='World parameter, NAME=VALUE, NAME="VALUE UNIT" or NAME=X,Y,Z; repeatable.'),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(help="MuJoCo scene to render: peg, outlet, boxes, drawer, or your own FILE.xml."),
    ] = None,
    body: Annotated[
        str | None, typer.Option(help="With --scene: body to hold (default: the one that the scene names).")
    ] = None,
    assets: Annotated[
        Path | None,
        typer.Option(help="With --scene: folder within which it may name meshes and files (default: its own)."),
    ] = None,
    grip: Annotated[
        str, typer.Option(help="With --scene: grip of the hand: loose, light, firm or MASS,DAMPING,STIFFNESS.")
    ] = "light",
    latency: Annotated[
        float | None,
        typer.Option(help="With --scene: latency of the tracker [ms] (default: 0; 5 for an external tracker)."),
    ] = None,
    driver: Annotated[
        str, typer.Option(help="Driver: sim (simulated device), serial:PORT or i2c:BUS (real device).")
    ] = "sim",
    tracker: Annotated[
        str,
        typer.Option(
            help="Source of the tool pose: pointer (in the console), hall (field sensors), osc:PORT, "
            "osc:HOST:PORT, lsl:NAME[/SOURCE], natnet:HOST[:PORT][/BODY], replay:FILE."
        ),
    ] = "pointer",
    prediction: Annotated[
        float, typer.Option(help="Longest time by which a tracker's pose is predicted [ms], 0 to 20.")
    ] = 4.0,
    estimator: Annotated[
        str | None,
        typer.Option(help="Estimator: tracker or, from a motor's field sensors, least-squares, network, linear."),
    ] = None,
    calibration: Annotated[Path | None, typer.Option(help="Calibration file, from `haptorb calibrate`.")] = None,
    frame: Annotated[
        Path | None, typer.Option(help="Frame file, from `haptorb frame`, for a tracker with its own frame.")
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(help="Controller model of coils and magnets, such as exact or published; default: the first."),
    ] = None,
    render: Annotated[
        str | None,
        typer.Option(
            help="Part of the world's wrench to render on a tool: force, torque, both (default: as the world defines)."
        ),
    ] = None,
    torque_arm: Annotated[
        float | None,
        typer.Option(
            help="With --render both: arm that weights torque errors against force errors [mm] (default: 43.5)."
        ),
    ] = None,
    hand: Annotated[
        Path | None,
        typer.Option(help="Motion of the simulated hand, with buttons: a CSV file, a script or a recording (MCAP)."),
    ] = None,
    hand_start: Annotated[
        str,
        typer.Option(
            help="When that motion begins: run (with the loop), or program (when a program of --serve native opens the "
            "device)."
        ),
    ] = "run",
    rate: Annotated[float, typer.Option(help="Loop rate [Hz], 50 to 4000.")] = 1000.0,
    seed: Annotated[int, typer.Option(help="Seed of a simulated device: it chooses its deviations and its noise.")] = 0,
    record: Annotated[Path | None, typer.Option(help="Record to this MCAP file.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Let --record replace an existing file.")] = False,
    headless: Annotated[bool, typer.Option("--headless", help="Run without the console.")] = False,
    duration: Annotated[float | None, typer.Option(help="Duration [s] (default: until Ctrl-C).")] = None,
    no_watchdog: Annotated[
        bool,
        typer.Option("--no-watchdog", help="Drive i2c:BUS without a monostable on OE; nobody may touch the device."),
    ] = False,
    serve: Annotated[
        list[str] | None,
        typer.Option(
            help="Serve programs: haply[:HOST][:PORT[:EVENTS]], osc[:[HOST:]PORT], lsl, foxglove[:PORT], "
            "native[:SCALE]; repeatable."
        ),
    ] = None,
    port: Annotated[int, typer.Option(help="Port of the console; 0 takes any free port.")] = 8765,
    host: HostOption = "127.0.0.1",
    address: AddressOption = "",
    browser: Annotated[bool, typer.Option("--open", help="Open the console in the browser.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the report at the end as one JSON object.")] = False,
) -> None:
    """Run a device with a world and the console. Default: simulated Omni with a dome."""
    if duration is not None and not 0 < duration < float("inf"):
        raise InputError(f"--duration must be greater than 0 s; got {duration:g} s")
    from haptorb.runtime.linux import describe_timing
    from haptorb.runtime.prestart import PrestartedProcess
    from haptorb.web.server import PageAddress

    where = PageAddress(host, address)
    with PrestartedProcess() as standby:  # it starts while this process does, and reads the device file
        from haptorb.cli.progress import build_tables
        from haptorb.cli.world_option import choose_scene_option, choose_world_option, refuse_scene_options
        from haptorb.devices.loader import load
        from haptorb.files import state_folder
        from haptorb.runtime.config import RunConfig
        from haptorb.runtime.servo import Servo
        from haptorb.serve.base import (
            Serving,
            add_client_force,
            check_hand_start,
            check_servers,
            hold_tool,
            is_client_force_alone,
        )

        choices = check_servers(serve or [])
        found = load(device)
        chosen: World | WorldFile | SceneFile
        if scene is None and body is None:
            refuse_scene_options(world, grip, latency)
            first = "remote" if is_client_force_alone(choices) else found.kind.world
            chosen = choose_world_option(world or first, settings or [], found)
        else:
            chosen = choose_scene_option(scene, body, world, settings or [], found, assets)
        build_tables(found)
        from haptorb.web.session import list_world_remarks

        config = RunConfig.of(
            found, add_client_force(chosen, choices), driver=driver, tracker=tracker, prediction=1e-3 * prediction,
            frame=frame, rate=rate, seed=seed, model=model, estimator=estimator, calibration=calibration,
            watchdog=not no_watchdog, render=render, torque_arm=None if torque_arm is None else 1e-3 * torque_arm,
            grip=grip, latency=None if latency is None else 1e-3 * latency, hand=hand,
            hand_start=check_hand_start(hand_start, hand, choices),
        )  # fmt: skip
        if headless:
            config = hold_tool(config, choices)
        servo = Servo(config, record=record or False, overwrite=force, black_box=state_folder() / "trips")
        for name, own in servo.own_worlds.items():
            for remark in list_world_remarks(own, 1.0 / servo.rate) if name == servo.world[0] else ():
                notify(remark)
        if servo.coupling:
            notify(servo.coupling)
        if timing := describe_timing():
            notify(timing)
        with Serving(choices, servo) as serving:
            number = (
                _run_without_console(servo, standby, serving, duration, json)
                if headless
                else _run_with_console(servo, standby, serving, duration, port, browser, json, where)
            )
        for file in servo.trip_files:
            notify(f"last ticks before the trip: {file}")
    if number:
        raise typer.Exit(128 + number)


def _run_without_console(
    servo: Servo, standby: PrestartedProcess, serving: Serving, duration: float | None, json: bool
) -> int:
    with queue_output(), _open_servo(servo, standby, serving):
        if not json:
            world, driver = servo.world[0], _driver_text(servo)
            notify(f"{servo.device.name}, world '{world}', {servo.rate:g} Hz, {driver}. Ctrl-C ends.")
        try:
            with notify_missing_pose(servo), notify_rendered_part(servo):
                try:
                    servo.run(duration if duration is not None else 1e9)
                finally:
                    servo.end_loop()
            number = 0
        except KeyboardInterrupt:
            number = int(signal.SIGINT)
        except Termination as end:
            number = end.number
    _report(servo, json)
    return number


def _run_with_console(
    servo: Servo,
    standby: PrestartedProcess,
    serving: Serving,
    duration: float | None,
    port: int,
    browser: bool,
    json: bool,
    where: PageAddress,
) -> int:
    from time import monotonic

    from haptorb.web.console import Console
    from haptorb.web.server import freeze_garbage

    if where.warning:
        notify(where.warning)
    with (
        queue_output(),
        Console(servo, port, where=where) as console,
        freeze_garbage(),
        _open_servo(servo, standby, serving),
    ):
        end = float("inf") if duration is None else monotonic() + duration
        last, invited = "", False

        def poll() -> bool:
            nonlocal last, invited
            if console.answers and not invited:
                invited = True
                notify(f"Open {console.url} in a browser: {servo.device.name}, {_driver_text(servo)}. Ctrl-C ends.")
            now = servo.world_trouble
            if now and not last:
                notify(now)
            last = now
            return monotonic() > end

        with notify_missing_pose(servo), notify_rendered_part(servo):
            number = console.serve(open_browser=browser, until=poll)
        servo.check_end()  # a servo that failed reports why, and sets the exit code
    _report(servo, json)
    return number or 0


@contextmanager
def _open_servo(servo: Servo, standby: PrestartedProcess, serving: Serving) -> Iterator[None]:
    """Run `servo` and close it on exit, the loop first; explain a slow start."""
    hint = Timer(
        3.0, notify, ["Starting ... The first start after an installation compiles code: about 15 s on two cores."]
    )
    hint.daemon = True
    hint.start()
    try:
        servo.open(standby)
        serving.start()
    except BaseException:
        _close(servo, serving)
        raise
    finally:
        hint.cancel()
    try:
        if servo.warning:
            notify(f"Warning: {servo.warning}")
        if servo.tracker_token:
            notify(f"A program on another computer must send this token before its poses: {servo.tracker_token}")
        for line in serving.lines:
            notify(line)
        yield
    finally:
        _close(servo, serving)
        if servo.report()["coil_state"] == "unknown":
            notify("COIL STATE UNKNOWN: the device did not confirm that its coils are off. Switch off its supply.")


def _close(servo: Servo, serving: Serving) -> None:
    """Close the loop first. A signal meanwhile is handled after both are closed: either would raise it at its end."""

    def close(_: Event) -> None:
        servo.end_loop()
        try:
            serving.end()
        finally:
            servo.close()

    run_uninterrupted(close)


def _driver_text(servo: Servo) -> str:
    return "SIMULATED" if servo.driver == "sim" else f"driver {servo.driver}"


def _report(servo: Servo, json: bool) -> None:
    from haptorb.display import format_beside
    from haptorb.runtime.report import describe_detail
    from haptorb.serve.base import describe_servers

    report: dict[str, Any] = servo.report()
    if json:
        print_json(report, line=True)
        return
    rate, late = report["success_rate"], report["lateness_us"]["p99"]
    if rate is not None and late is not None:
        torque = f", torque {1e3 * report['peak_torque_nm']:.1f} mN·m"
        turned = torque if report["rendered_part"] in ("torque", "both") else ""
        notify(
            f"{report['ticks']} ticks, {format_beside(100 * rate, 100.0, 2)} % on time, p99 lateness {late:.0f} µs, "
            + (
                f"peak torque {report['peak_torque_nm']:.2f} N·m"
                if servo.modes
                else f"peak force {report['peak_force_n']:.2f} N{turned}"
            )
        )
    if "rate_hz" in (poses := report["tracking"]):
        notify(describe_tracking(servo.tracker, poses))
    if heavy := describe_detail(report.get("scene", {})):
        notify(heavy)
    for line in describe_servers(report.get("servers", [])):
        notify(line)
    for trip in report["trips"]:
        by = f" (while {trip['program']} commanded)" if trip["program"] else ""
        notify(f"tripped at {trip['t']:.2f} s{by}: {trip['reason']}")
