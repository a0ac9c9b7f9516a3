"""`haptorb devices`, `haptorb worlds` and `haptorb inspect`: what is there, and what it can do."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from haptorb.apps.terminal import Column, TextTable, make_console, print_facts, print_json, print_table, print_text
from haptorb.errors import InputError

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""
    app.command()(devices)
    app.command()(worlds)
    app.command()(inspect)


def devices(json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False) -> None:
    """List the devices that come with haptorb."""
    from haptorb.devices.loader import catalogue

    _list(catalogue(), json)


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
    print_text(console, _nature(world.passive, world.continuous), "dim")
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


def _nature(passive: bool, continuous: bool) -> str:
    energy = "passive: produces no energy" if passive else "active: a closed path can gain energy"
    return f"{energy}; {'continuous' if continuous else 'discontinuous'}"


def inspect(
    device: Annotated[str, typer.Argument(help="Device name, or path of a device file.")],
    plot: Annotated[Path | None, typer.Option(help="Draw the figures into this PNG or SVG file.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    assumed: Annotated[bool, typer.Option("--assumed", help="List the assumed values with their reasons.")] = False,
    override: Annotated[bool, typer.Option("--override", help="Inspect a device that the validation refuses.")] = False,
) -> None:
    """Show a device's workspace, forces, heat limits and model errors."""
    from haptorb.devices.loader import load

    found = load(device, override=override)
    if assumed:
        _list(dict(found.assumed), json)
        return
    if plot is not None and plot.suffix not in (".png", ".svg"):
        raise InputError(f"--plot must be a .png or .svg file; got '{plot}'")
    if plot is not None and not plot.parent.is_dir():
        raise InputError(f"--plot: the folder '{plot.parent}' does not exist")
    from haptorb.apps.inspect.card import card
    from haptorb.apps.progress import build_tables

    build_tables(found)
    made = card(found)
    if json:
        print_json(made.numbers())
    else:
        made.show(make_console())
    if plot is not None:
        made.plot(plot)


def _list(lines: dict[str, str], json: bool) -> None:
    if json:
        print_json(lines)
    else:
        print_facts(make_console(), lines.items())
