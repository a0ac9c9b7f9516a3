"""`haptorb hardware probe | monitor | jog | emulate`: find a device, read sensors, test a coil, emulate a device."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from haptorb.terminal import CommandLine, echo, notify, print_json

__all__ = ["register"]

hardware = CommandLine(help="Bring up a real device: find it, read its sensors, drive one coil gently.")

DriverOption = Annotated[str, typer.Option("--driver", help="Driver, as printed by `probe`: serial:PORT or i2c:BUS.")]
DeviceArgument = Annotated[str, typer.Argument(help="Device name, or path of a device file.")]

JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""
    app.add_typer(hardware, name="hardware")


@hardware.command()
def probe(
    port: Annotated[list[str] | None, typer.Option("--port", help="Only these serial ports.")] = None,
    bus: Annotated[list[int] | None, typer.Option("--bus", help="Only these I²C buses.")] = None,
    json: JsonOption = False,
) -> None:
    """Find connected devices and list the parts that respond. The coils stay off."""
    from haptorb.runtime.linux import require_linux

    require_linux("`haptorb hardware`")
    from haptorb.cli.board_tools import probe as findings

    only = bool(port or bus)
    answered = False
    found = []
    for one in findings(port or ([] if only else None), bus or ([] if only else None)):
        answered |= bool(one.driver)
        found.append({**vars(one), "about": list(one.about)})
        if json:
            continue
        echo(f"{one.place}: {'responds' if one.answers else 'no answer'}")
        for sentence in one.about:
            echo(f"  {sentence}", indent="    ")
        if one.driver:
            echo(f"  use it with --driver {one.driver}", indent="    ")
    if json:
        print_json(found)
    if not answered:
        (notify if json else echo)("no device found: check power and cable, or name a port with --port")
        raise typer.Exit(1)


@hardware.command()
def monitor(
    driver: DriverOption,
    device: DeviceArgument = "omni",
    rate: Annotated[float, typer.Option(help="Lines per second [Hz].")] = 5.0,
    duration: Annotated[float, typer.Option(help="Duration [s] (default: until Ctrl-C).", show_default=False)] = float(
        "inf"
    ),
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object per line.")] = False,
) -> None:
    """Show currents, temperatures and fields live, with the coils off."""
    from haptorb.cli.board_tools import line, numbers
    from haptorb.cli.board_tools import monitor as samples
    from haptorb.devices.loader import load
    from haptorb.runtime.drivers.registry import real_driver

    through = real_driver(driver, load(device), watchdog=False)  # none needed: the coils stay off
    for sample in samples(through, rate, duration):
        if json:
            print_json(numbers(sample, through.coil_state), line=True)
        else:
            echo(line(sample, through.coil_state), indent="            ")


@hardware.command()
def jog(
    coil: Annotated[str, typer.Argument(help="Coil: x, y or z.")],
    driver: DriverOption,
    device: DeviceArgument = "omni",
    duty: Annotated[float, typer.Option(help="Peak duty, −0.2 to 0.2.")] = 0.05,
    duration: Annotated[
        float, typer.Option("--duration", "--seconds", help="Duration of ramp up, hold and ramp down [s], 0.2 to 10.")
    ] = 1.0,
    current: Annotated[float, typer.Option(help="Switch off above this current [A].")] = 3.0,
    no_watchdog: Annotated[
        bool,
        typer.Option("--no-watchdog", help="Drive i2c:BUS without a monostable on OE; nobody may touch the device."),
    ] = False,
    json: JsonOption = False,
) -> None:
    """Drive one coil gently and check its current. Keep the tool away from the dome."""
    from haptorb.cli.board_tools import GENTLE_DUTY, state_words
    from haptorb.cli.board_tools import jog as moved
    from haptorb.devices.loader import load
    from haptorb.runtime.drivers.registry import real_driver
    from haptorb.runtime.linux import prepare_thread

    it = load(device)
    through = real_driver(
        driver, it, duty_limit=GENTLE_DUTY, current_limit=min(max(current, 0.1), 60.0), watchdog=not no_watchdog
    )
    prepare_thread()  # the firmware switches off after 15 ms of silence, even if this computer is busy
    try:
        reading = moved(it, through, coil, duty, duration, current)
    finally:
        (notify if json else echo)(f"coils: {state_words(through.coil_state)}")
    if json:
        print_json({"coil": reading.coil, "duty": reading.duty, "currents_a": list(reading.currents),
                    "resistance_ohm": reading.resistance if reading.resistance == reading.resistance else None,
                    "verdict": list(reading.verdict), "coil_state": through.coil_state.name.lower()})  # fmt: skip
        if reading.verdict:
            raise typer.Exit(1)
        return
    currents = ", ".join(f"{name} {one:+.3f} A" for name, one in zip(it.coils.names, reading.currents, strict=True))
    echo(f"coil {reading.coil}: duty {reading.duty:+.4f}, currents {currents}, resistance {reading.resistance:.3f} Ω")
    for sentence in reading.verdict:
        echo(f"  {sentence}", indent="    ")
    if reading.verdict:
        raise typer.Exit(1)


@hardware.command()
def emulate(
    device: Annotated[
        str, typer.Argument(help="Spherical electromagnet: device name, or path of a device file.")
    ] = "omni",
    port: Annotated[Path, typer.Option(help="Path of the emulated serial port.")] = Path("/tmp/haptorb-omni"),
    board: Annotated[str, typer.Option(help="Board: m328p or m2560.")] = "m328p",
    build: Annotated[Path, typer.Option(help="Build folder of `make firmware`.")] = Path("firmware/build"),
    height: Annotated[
        float | None,
        typer.Option(
            help="Height of the tool's magnet above the centre [mm] (default: just above the dome); "
            "500 is far enough for the first steps of a calibration."
        ),
    ] = None,
    led: Annotated[
        bool, typer.Option("--led", help="Move the tool over the dome, for the calibration step 'sensors'.")
    ] = False,
    dead: Annotated[int | None, typer.Option(help="Number of a failed field sensor, from 1.")] = None,
    duration: Annotated[float, typer.Option(help="Duration [s] (default: until Ctrl-C).", show_default=False)] = float(
        "inf"
    ),
) -> None:
    """Run the real firmware on an emulated board with a simulated device, for trying the other commands."""
    from haptorb.runtime.linux import require_linux

    require_linux("`haptorb hardware`")
    from haptorb.cli.board_tools import emulate as run
    from haptorb.devices.loader import load

    echo(f"starting an emulated device: use it with --driver serial:{port}. Ctrl-C ends.")
    run(
        load(device), build, port, board, duration, height=None if height is None else 1e-3 * height, led=led, dead=dead
    )
