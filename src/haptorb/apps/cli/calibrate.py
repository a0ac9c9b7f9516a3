"""`haptorb calibrate`: what this very device does per ampere and per watt, into a file that names it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from haptorb.errors import InputError

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command()(calibrate)


def calibrate(
    device: Annotated[str, typer.Argument(help="A device's name, or the path of a device file.")] = "omni",
    driver: Annotated[str, typer.Option(help="sim, serial:PORT or i2c:BUS.")] = "sim",
    out: Annotated[Path | None, typer.Option(help="File to write [DEVICE.calibration.json].")] = None,
    thermal: Annotated[
        Path | None,
        typer.Option(help="A record of heating and cooling: an MCAP recording, or CSV with t_s, power_w, "
                          "winding_degc, boundary_degc."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the file if it is there.")] = False,
    seed: Annotated[int, typer.Option(help="Of the simulation's noise.")] = 0,
    json: Annotated[bool, typer.Option("--json", help="Print the calibration as JSON.")] = False,
) -> None:  # fmt: skip
    """Calibrate a device: polarity, current sensing, field per ampere, and heat from a record. Take the tool away."""
    from haptorb.apps.calibrate import calibrate as measured
    from haptorb.apps.calibrate import thermal_record
    from haptorb.apps.calibrate.door import door
    from haptorb.devices.electromagnet import SphericalElectromagnet
    from haptorb.devices.loader import load
    from haptorb.runtime.calibration_file import writable, write_calibration

    found = load(device)
    if not isinstance(found, SphericalElectromagnet) or not found.sensors:
        raise InputError(f"device '{found.name}': only spherical electromagnets with field sensors are calibrated")
    path = writable(out or Path(f"{found.name}.calibration.json"), overwrite=force)
    heat = None if thermal is None else thermal_record(thermal, found).identified()

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    through, pace = door(driver, found, seed)
    result = measured(found, through, heat, pace=pace, say=say)
    write_calibration(result, path, overwrite=force)
    if json:
        print(result.text(), end="")
        return
    print(f"m_e per ampere [m²], ± standard deviation; rms left {result.residual * 1e6:.1f} µT, "
          f"condition {result.condition:.1f}, repeatable to {100 * result.repeatability:.2f} %")  # fmt: skip
    for row, spread in zip(result.moment_per_current, result.uncertainty, strict=True):
        print("  " + "  ".join(f"{value:+.5f} ± {s:.5f}" for value, s in zip(row, spread, strict=True)))
    print("coils: " + ", ".join(f"{name} {r:.4f} Ω" for name, r in zip(found.coils.names, result.resistance,
                                                                      strict=True)))  # fmt: skip
    if heat is not None:
        rise = found.coils.heat.derate - found.coils.heat.ambient
        hot, half = heat.endurance(rise, 240.0), heat.endurance(rise, 60.0)
        model = heat.model
        sustained = rise / (1 / model.winding_to_body + 1 / model.body_to_air)
        print(f"heat: {sustained:.1f} W for ever, 240 W for {hot:.1f} s, 60 W for {half:.0f} s; rms left "
              f"{heat.residual:.2f} K")  # fmt: skip
    print(f"written: {path}{' (of a simulation)' if result.simulated else ''}")
