"""`haptorb devices`, `worlds`, `inspect` and `show`: list devices and worlds, print capabilities, draw a device."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptorb.errors import InputError, UnknownName
from haptorb.terminal import (
    Column,
    TextTable,
    echo,
    make_console,
    make_progress,
    print_facts,
    print_file,
    print_json,
    print_table,
    print_text,
)

if TYPE_CHECKING:
    from haptorb.cli.card import Card
    from haptorb.cli.error_report import ErrorReport
    from haptorb.devices.base import Device

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""
    app.command()(devices)
    app.command()(worlds)
    app.command()(inspect)
    app.command()(show)


def devices(
    name: Annotated[str | None, typer.Argument(help="Device whose file to print.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List the devices that come with haptorb; with a name, print its file: haptorb devices omni > mine.toml."""
    from haptorb.devices.loader import catalogue

    known = catalogue()
    if name is None:
        _list(known, json)
        return
    if name not in known:
        raise UnknownName("device", name, known)
    from importlib.resources import files

    text = (files("haptorb.devices") / "catalogue" / f"{name}.toml").read_text(encoding="utf-8")
    if json:
        print_json({"name": name, "file": text})
    else:
        print_file(text)


def worlds(
    name: Annotated[str | None, typer.Argument(help="World whose parameters to list.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List the worlds; with a name, the parameters of that world."""
    from haptorb.worlds import CATALOGUE, find_world
    from haptorb.worlds.base import parameters
    from haptorb.worlds.dynamic import DynamicWorld

    if name is None:
        _list({key: (world.__doc__ or "").splitlines()[0] for key, world in CATALOGUE.items()}, json)
        return
    known = parameters(find_world(name)).values()
    if json:
        fields = ("name", "unit", "low", "high", "default", "about")
        print_json([{field: getattr(item, field) for field in fields} for item in known])
        return
    console = make_console()
    world = find_world(name)
    print_text(console, f"{name}: {(world.__doc__ or '').splitlines()[0]}", "bold")
    print_text(console, _energy_text(world.passive, world.continuous, world.needs_object), "dim")
    made = world()
    if isinstance(made, DynamicWorld):
        print_text(console, f"memory: {', '.join(f'{one.name} [{one.unit}]' for one in made.memory_fields)}", "dim")
    for remark in made.remarks:
        print_text(console, remark)
    if not known:
        return
    print_text(console)
    table = TextTable((Column("parameter", kind="key"), Column("default", kind="short"), Column("range", kind="short"),
                       Column("meaning", kind="text")))  # fmt: skip
    for item in known:
        default = item.default if isinstance(item.default, tuple) else (item.default,)
        unit = f" {item.unit}" if item.unit != "1" else ""
        table.add_row(
            item.name, ", ".join(f"{x:g}" for x in default) + unit, f"{item.low:g} … {item.high:g}{unit}", item.about
        )
    print_table(console, table)


def _energy_text(passive: bool, continuous: bool, needs_object: bool) -> str:
    energy = "passive: produces no energy" if passive else "active: a closed path can gain energy"
    devices = "; for devices that move an object (motors)" if needs_object else ""
    return f"{energy}; {'continuous' if continuous else 'discontinuous'}{devices}"


def inspect(
    devices: Annotated[list[str], typer.Argument(help="Device names, or paths of device files: one or several.")],
    plot: Annotated[Path | None, typer.Option(help="Write the figures to this PNG, SVG or PDF file.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON; a list for several devices.")] = False,
    assumed: Annotated[bool, typer.Option("--assumed", help="List the assumed values with their reasons.")] = False,
    override: Annotated[bool, typer.Option("--override", help="Inspect a device that fails the validation.")] = False,
    errors: Annotated[
        bool, typer.Option("--errors", help="Show the error budget of the delivered wrench of one device.")
    ] = False,
    wrench: Annotated[
        str | None,
        typer.Option(
            help='With --errors: commanded wrench, such as "100 mN" or "0.4 N*m" (default: half of the smallest peak).'
        ),
    ] = None,
    estimator: Annotated[
        str | None,
        typer.Option(
            help="With --errors: source of the mover's pose: tracker, hall (field sensors of a tool), least-squares "
            "(field sensors of a motor); default: tracker, of a motor least-squares."
        ),
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="With --errors: calibration file, from `haptorb calibrate`.")
    ] = None,
    samples: Annotated[
        int, typer.Option(help="With --errors: number of simulated devices for each region of the workspace.")
    ] = 2000,
    seed: Annotated[int, typer.Option(help="With --errors: seed of the simulated devices.")] = 0,
    sensing: Annotated[
        bool,
        typer.Option(
            "--sensing", help="Show how accurately the field sensors locate the tool, for each source of error."
        ),
    ] = False,
) -> None:
    """Show the capabilities of a device: workspace, forces, heat limits, model errors; several devices side by side.

    With --errors: the 95 % band of the delivered wrench and its sources of error.
    """
    from haptorb.cli.cards import card
    from haptorb.cli.comparison import Comparison, name_devices
    from haptorb.cli.progress import build_tables
    from haptorb.devices.loader import load
    from haptorb.figure_file import check_figure_file, write_figure

    if not errors and (wrench, estimator, calibration) != (None, None, None):
        raise InputError("--wrench, --estimator and --calibration belong to --errors")
    found = [load(device, override=override) for device in devices]
    labels = name_devices(found, devices)
    if assumed:
        if len(found) > 1:
            raise InputError(f"--assumed lists the values of one device; got {len(found)}")
        _list(dict(found[0].assumed), json)
        return
    if sensing:
        _print_sensing(found, json)
        return
    if plot is not None:
        check_figure_file(plot, "--plot")
    for one in found:
        build_tables(one)
    report: ErrorReport | Card | Comparison
    if errors:
        if len(found) > 1:
            raise InputError(f"--errors is for one device; got {len(found)}")
        report = _budget_errors(found[0], wrench, estimator, calibration, samples, seed)
    else:
        cards = [card(one) for one in found]
        report = cards[0] if len(cards) == 1 else Comparison(cards, labels)
    if plot is not None:
        write_figure(report.draw(), plot, "--plot")
    if json:
        print_json(report.numbers())
    else:
        report.show(make_console())


def _budget_errors(
    device: Device, wrench: str | None, estimator: str | None, calibration: Path | None, samples: int, seed: int
) -> ErrorReport:
    """Compute the error budget with a progress bar."""
    from haptorb.cli.error_report import report_errors
    from haptorb.devices.quantity import si
    from haptorb.estimation.calibration_file import read_calibration

    if not 100 <= samples <= 100_000 or seed < 0:
        raise InputError(f"--samples must be 100 to 100000 and --seed 0 or more; got {samples} and {seed}")
    unit, kind = ("N*m", "a torque") if device.shell is None else ("N", "a force")
    try:
        asked = None if wrench is None else si(wrench, unit, kind)
    except ValueError as cause:
        raise InputError(f"--wrench {cause}") from cause
    known = None if calibration is None else read_calibration(calibration)
    with make_progress() as bar:
        task = bar.add_task("drawing devices", total=1.0)
        return report_errors(
            device, asked=asked, estimator=estimator, calibration=known, samples=samples, seed=seed,
            report=lambda done: bar.update(task, completed=done),
        )  # fmt: skip


def _print_sensing(devices: list[Device], json: bool) -> None:
    from haptorb.cli.sensing_accuracy import sensing_accuracy

    if len(devices) > 1:
        raise InputError(f"--sensing is for one device; got {len(devices)}")
    found = sensing_accuracy(devices[0])
    if json:
        print_json(found.numbers())
    else:
        found.show(make_console())


def show(
    device: Annotated[str, typer.Argument(help="Device name, or path of a device file.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="PNG, SVG or PDF file to write (default: DEVICE.drawing.png).")
    ] = None,
    view: Annotated[str, typer.Option(help="View: section, 3d or both.")] = "both",
    azimuth: Annotated[float, typer.Option(help="Azimuth of the section plane [deg], from +x towards +y.")] = 0.0,
    json: Annotated[
        bool, typer.Option("--json", help="Print the parts and their positions as JSON; with -o, draw too.")
    ] = False,
    override: Annotated[bool, typer.Option("--override", help="Draw a device that fails the validation.")] = False,
) -> None:
    """Draw a device to scale: coils, magnets, core and sensors in section and in three dimensions."""
    from haptorb.devices.base import require_geometry
    from haptorb.devices.geometry import describe_geometry
    from haptorb.devices.loader import load
    from haptorb.figure_file import check_figure_file, write_figure

    found = load(device, override=override)
    if output is None and not json:
        output = Path(f"{found.name}.drawing.png")
    if output is not None:
        check_figure_file(output, "--output")
        write_figure(found.draw(view, azimuth), output, "--output")
    if json:
        geometry = require_geometry(found, "`haptorb show`")
        print_json({"name": found.name, "digest": found.digest, **describe_geometry(geometry)})
    else:
        echo(f"written: {output}")


def _list(lines: dict[str, str], json: bool) -> None:
    if json:
        print_json(lines)
    else:
        print_facts(make_console(), lines.items())
