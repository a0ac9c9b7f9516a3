"""`haptorb calibrate`: measures current sensing, field per ampere, heat and field sensors of one individual device."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptorb.errors import InputError
from haptorb.terminal import Column, TextTable, echo, make_console, notify, print_json, print_table

if TYPE_CHECKING:
    from haptorb.cli.calibration_steps import Step

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(calibrate)


def calibrate(
    device: Annotated[str, typer.Argument(help="Device name, or path of a device file.")] = "omni",
    driver: Annotated[str, typer.Option(help="Driver: sim, serial:PORT or i2c:BUS.")] = "sim",
    out: Annotated[Path | None, typer.Option(help="File to write (default: DEVICE.calibration.json).")] = None,
    steps: Annotated[
        str | None,
        typer.Option(help="Only these steps, comma-separated: rest, currents, magnetic, fields, heat, tool, sensors."),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Do not prompt; the device is ready.")] = False,
    thermal: Annotated[
        Path | None,
        typer.Option(help="Thermal record instead of the heat step: an MCAP recording, or CSV with t_s, power_w, "
                          "winding_degc, boundary_degc; for coupled coils power_NAME_w and so on."),
    ] = None,
    loads: Annotated[
        Path | None,
        typer.Option(help="Readings of a load cell, CSV: x_m, y_m, z_m and qx, qy, qz, qw of the tool, current_NAME_a, "
                          "fx_n, fy_n, fz_n, tx_nm, ty_nm, tz_nm."),
    ] = None,
    restart: Annotated[bool, typer.Option("--restart", help="Repeat steps that are already done.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    no_watchdog: Annotated[
        bool,
        typer.Option("--no-watchdog", help="Drive i2c:BUS without a monostable on OE; nobody may touch the device."),
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of a simulated device: it chooses its deviations and its noise.")] = 0,
    json: Annotated[bool, typer.Option("--json", help="Print the calibration as JSON.")] = False,
) -> None:  # fmt: skip
    """Calibrate a device: current sensing, field per ampere, heat, tool and field sensors. It can be resumed."""
    import numpy as np

    from haptorb.cli.calibration_dialog import Dialog, check_steps, guide_calibration
    from haptorb.cli.calibration_measurement import make_driver
    from haptorb.cli.progress import time_bar
    from haptorb.cli.thermal_record import thermal_record
    from haptorb.devices.api import electromagnet
    from haptorb.devices.loader import load
    from haptorb.estimation.calibration_file import check_writable
    from haptorb.estimation.load_cell_calibration import read_loads
    from haptorb.runtime.linux import prepare_thread

    found = electromagnet(load(device), "`haptorb calibrate`")
    if not found.sensors:
        raise InputError(f"device '{found.name}' has no field sensors; `haptorb calibrate` needs them")
    names = None if steps is None else [name.strip() for name in steps.split(",")]
    chosen = check_steps(names, () if thermal is None else ("heat",))
    path = check_writable(out or Path(f"{found.name}.calibration.json"), overwrite=force)
    heat = None if thermal is None else thermal_record(thermal, found).measure()
    weighed = None if loads is None else read_loads(loads, found)
    through, pace = make_driver(driver, found, seed, watchdog=not no_watchdog)
    asks = not (yes or through.simulated)
    if asks and not sys.stdin.isatty():
        raise InputError(
            "calibrating a real device prompts before every step, and there is no terminal: add --yes if the "
            "device is ready for all of them (--steps selects some)"
        )
    if not through.simulated:
        prepare_thread()  # the firmware switches off after 15 ms of silence, even if this computer is busy
    result = guide_calibration(
        found, through, path, steps=chosen, heat=heat, loads=weighed, pace=pace, restart=restart, overwrite=force,
        guide=Dialog(notify, _prompt if asks else lambda step: True, lambda step, time: time_bar(step.title, time)),
    )  # fmt: skip
    if result is None:
        raise typer.Exit(1)
    if json:
        from json import loads as parse_json

        print_json(parse_json(result.text()))
        return
    columns = (Column("axis", kind="key"), *(Column(f"coil {name}", "m²") for name in found.coils.names))
    table = TextTable(columns, "Moment per ampere, ± standard deviation")
    for axis, row, spread in zip("xyz", result.moment_per_current, result.uncertainty, strict=True):
        table.add_row(axis, *(f"{value:+.5f} ± {s:.5f}" for value, s in zip(row, spread, strict=True)))
    print_table(make_console(), table)
    echo(f"residual {result.residual * 1e6:.1f} µT rms, condition {result.condition:.1f}, repeatable to "
         f"{100 * result.repeatability:.2f} %")  # fmt: skip
    echo("coils: " + ", ".join(f"{name} {r:.4f} Ω" for name, r in zip(found.coils.names, result.resistance,
                                                                     strict=True)))  # fmt: skip
    if result.heat is not None:
        values = result.heat.apply(found)
        network, rise = values.network(found.channels), values.derate - values.ambient
        alone = np.arange(found.channels) == int(network.rise_per_watt.diagonal().argmax())
        hot, half = network.time_to(rise, 240.0 * alone), network.time_to(rise, 60.0 * alone)
        echo(f"heat of one coil: {rise / network.rise_per_watt.diagonal().max():.1f} W continuous, 240 W for {hot:.1f} "
             f"s, 60 W for {half:.0f} s")  # fmt: skip
        if values.coupling is not None:
            echo(f"heat of all coils together: {rise / network.rise_per_watt.sum(axis=1).max():.1f} W continuous in "
                 "each")  # fmt: skip
    echo(f"written: {path}{' (simulated)' if result.simulated else ''}, id {result.id.hex()}")


def _prompt(step: Step) -> bool:
    return typer.confirm("    ready", default=True, err=True)
