"""`haptorb devices`, `worlds`, `inspect` and `show`: what is there, what it can do, and what it looks like."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptorb.apps.terminal import (
    Column,
    TextTable,
    make_console,
    print_facts,
    print_json,
    print_table,
    print_text,
    tell,
)
from haptorb.errors import InputError, UnknownName

if TYPE_CHECKING:
    from haptorb.devices.device import Device

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""
    app.command()(devices)
    app.command()(worlds)
    app.command()(inspect)
    app.command()(show)


def devices(
    name: Annotated[str | None, typer.Argument(help="Device whose file is printed, to start your own from.")] = None,
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
        print_text(make_console(), text.rstrip("\n"))


def worlds(
    name: Annotated[str | None, typer.Argument(help="World whose parameters are listed.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List the worlds; with a name, the parameters of that world."""
    from haptorb.worlds import CATALOGUE, find_world
    from haptorb.worlds.parameter import parameters

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
    print_text(console, _nature(world.passive, world.continuous, world.needs_target), "dim")
    for remark in world().remarks:
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


def _nature(passive: bool, continuous: bool, needs_target: bool) -> str:
    energy = "passive: produces no energy" if passive else "active: a closed path can gain energy"
    devices = "; for devices that move a target (motors)" if needs_target else ""
    return f"{energy}; {'continuous' if continuous else 'discontinuous'}{devices}"


def inspect(
    devices: Annotated[list[str], typer.Argument(help="Device names, or paths of device files: one or several.")],
    plot: Annotated[Path | None, typer.Option(help="Draw the figures into this PNG, SVG or PDF file.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON; a list for several devices.")] = False,
    assumed: Annotated[bool, typer.Option("--assumed", help="List the assumed values with their reasons.")] = False,
    override: Annotated[bool, typer.Option("--override", help="Inspect a device that the validation refuses.")] = False,
    sensing: Annotated[
        bool, typer.Option("--sensing", help="How well the field sensors locate the tool, error by error.")
    ] = False,
) -> None:
    """Show what devices can do: workspace, forces, heat limits and model errors; several side by side."""
    from haptorb.apps.figure_file import check_figure_file, write_figure
    from haptorb.apps.inspect import Comparison, card, name_devices
    from haptorb.apps.progress import build_tables
    from haptorb.devices.loader import load

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
    cards = [card(one) for one in found]
    report = cards[0] if len(cards) == 1 else Comparison(cards, labels)
    if plot is not None:
        write_figure(report.draw(), plot, "--plot")
    if json:
        print_json(report.numbers())
    else:
        report.show(make_console())


def _print_sensing(devices: list[Device], json: bool) -> None:
    from haptorb.apps.inspect.sensing import sensing_accuracy

    if len(devices) > 1:
        raise InputError(f"--sensing tells about one device; got {len(devices)}")
    found = sensing_accuracy(devices[0])
    if json:
        print_json(found.numbers())
    else:
        found.show(make_console())


def show(
    device: Annotated[str, typer.Argument(help="Device name, or path of a device file.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="PNG, SVG or PDF file [DEVICE.drawing.png].")
    ] = None,
    view: Annotated[str, typer.Option(help="View: section, 3d or both.")] = "both",
    azimuth: Annotated[float, typer.Option(help="Direction of the section's plane [deg], from +x towards +y.")] = 0.0,
    json: Annotated[
        bool, typer.Option("--json", help="Print the parts and their places as JSON; draw with -o.")
    ] = False,
    override: Annotated[bool, typer.Option("--override", help="Draw a device that the validation refuses.")] = False,
) -> None:
    """Draw a device to scale: coils, magnets, core and sensors in section and in three dimensions."""
    from haptorb.apps.figure_file import check_figure_file, write_figure
    from haptorb.apps.show import describe_geometry
    from haptorb.devices.loader import load

    found = load(device, override=override)
    if output is None and not json:
        output = Path(f"{found.name}.drawing.png")
    if output is not None:
        check_figure_file(output, "--output")
        write_figure(found.draw(view, azimuth), output, "--output")
    if json:
        print_json(describe_geometry(found))
    else:
        tell(f"written: {output}")


def _list(lines: dict[str, str], json: bool) -> None:
    if json:
        print_json(lines)
    else:
        print_facts(make_console(), lines.items())
