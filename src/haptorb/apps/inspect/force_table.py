"""The tables of a spherical electromagnet's force over its shell: at the peak, and without a time limit."""

from __future__ import annotations

from rich.console import Console

from haptorb.apps.terminal import Column, TextTable, print_table, print_text
from haptorb.devices.electromagnet.remarks import FORCE_JND
from haptorb.devices.electromagnet.shell_capability import Layer

__all__ = ["print_force_tables"]


def print_force_tables(console: Console, layers: tuple[Layer, ...], supply: float, *, coupled: bool) -> None:
    """Print what the coils can do at each of `layers`; coupled ones last less when all are warm.

    supply: its power [W], inf for no limit.
    """
    peak = TextTable(
        (
            Column("distance", "mm", "key"), Column("peak radial", "mN"), Column("peak tangential", "mN"),
            Column("passive pull", "mN"), Column("dipole error", "%"), Column("dipole error", "JND"),
        ),
        "Force on a radial tool at the weakest position and direction in the workspace",
    )  # fmt: skip
    for layer in layers:
        peak.add_row(
            f"{layer.distance * 1e3:.0f}", f"{1e3 * layer.peak_radial:.0f}", f"{1e3 * layer.peak_tangential:.0f}",
            f"{1e3 * layer.passive_pull:.1f}", f"{100 * layer.dipole_error:.1f}", f"{layer.dipole_error_jnd:.1f}",
        )  # fmt: skip
    print_table(console, peak)
    limit = "" if supply == float("inf") else f"\npeak: within the supply's {supply:g} W, windings hot"
    print_text(
        console,
        f"dipole error: largest error of the dipole model's force. JND: just-noticeable difference, "
        f"{100 * FORCE_JND:.0f} % of force{limit}\n",
        "dim",
    )
    states = ("one coil warm", "all coils warm") if coupled else ("",)
    lasting = TextTable(
        (
            Column("distance", "mm", "key"),
            *(Column(f"{way} {state}".strip(), "mN") for way in ("radial", "tangential") for state in states),
        ),
        "Continuous force at the weakest position and direction in the workspace",
    )
    for layer in layers:
        radial = (layer.lasting_radial, layer.lasting_radial_all_warm)
        tangential = (layer.lasting_tangential, layer.lasting_tangential_all_warm)
        forces = (*radial[: len(states)], *tangential[: len(states)])
        lasting.add_row(f"{layer.distance * 1e3:.0f}", *(f"{1e3 * force:.0f}" for force in forces))
    print_table(console, lasting)
    if coupled:
        print_text(
            console,
            "one coil warm: each coil at its continuous current, the others off; all coils warm: all at the "
            "continuous current of that case",
            "dim",
        )
    print_text(console)
