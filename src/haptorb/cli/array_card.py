"""Capability card of a coil array: force along each axis by height, the weakest position, and the heat of a newton."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, final

import numpy as np
from rich.console import Console

from haptorb.cli.card import (
    Card,
    Curve,
    Quantity,
    common_curves,
    common_quantities,
    facts,
    print_build_checks,
    print_card,
)
from haptorb.control.capability import array_capability, map_contact
from haptorb.devices.base import endurance
from haptorb.devices.coil_array import CoilArray
from haptorb.terminal import Column, TextTable, print_table, print_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["CoilArrayCard"]


_COIL_ARRAY_AXES = ("x", "y", "z")


@final
class CoilArrayCard(Card):
    """Card of a coil array: forces by the exact model on an upright tool, on a dome a radial one."""

    _device: CoilArray

    def __init__(self, device: CoilArray) -> None:
        self._device = device
        self._contact = map_contact(device)
        contact, *above = array_capability(device)
        weakest = min(contact.weakest, float(np.nanmin(self._contact.weakest)))  # the key sets differ between the two
        self._layers = (replace(contact, weakest=weakest), *above)
        self._endurance = endurance(device)

    def numbers(self) -> dict[str, Any]:
        """Return everything on the card as plain JSON types."""
        device, surface = self._device, self._device.surface
        return {
            **facts(device),
            "sensed_dof": "6 by a tracker",
            "actuated_dof": min(device.channels, 5 if len(device.tool.magnets) == 1 else 6),
            "surface": "dome" if surface.is_dome else "plate",
            "contact_height_m": device.contact_height,
            "rendered_above_contact_m": surface.thickness,
            "core_radius_m": None if device.core is None else device.core.radius,
            "magnets": len(device.tool.magnets),
            "tool_moment_a_m2": device.tool.moment,
            "layers": [
                {
                    "above_contact_m": layer.height,
                    "peak_n": layer.peak.tolist(),
                    "continuous_n": layer.lasting.tolist(),
                    "weakest_peak_n": layer.weakest,
                    "passive_n": layer.passive,
                    "watts_per_newton2_up": layer.watts,
                }
                for layer in self._layers
            ],
            "contact": {
                "x_m": self._contact.x.tolist(),
                "y_m": self._contact.y.tolist(),
                "weakest_peak_n": [
                    [None if math.isnan(force) else force for force in row] for row in self._contact.weakest.tolist()
                ],
                "median_weakest_peak_n": self._contact.median,
            },
            "heat_between_coils": False,
            "endurance": [
                {"share_of_full_current": share, "seconds": seconds if math.isfinite(seconds) else None}
                for share, seconds in self._endurance
            ],
        }

    def show(self, console: Console) -> None:
        """Print the card on `console`."""
        device, surface = self._device, self._device.surface
        low, high = device.contact_height * 1e3, (device.contact_height + surface.thickness) * 1e3
        if surface.is_dome:
            angle = f"±{math.degrees(surface.half_angle):.0f}° about the summit"
            where = f"{angle}, tool {low:g} to {high:g} mm from the centre"
        else:
            x, y = (1e3 * side for side in surface.half_width)
            where = f"±{x:g} mm along x, ±{y:g} mm along y, tool {low:g} to {high:g} mm above the coils' frame"
        magnets = len(device.tool.magnets)
        missing = ", not the torque about the magnet's own axis" if magnets == 1 else ""
        more = [
            ("workspace", where),
            ("actuated", f"force, torque or both by {device.channels} coils{missing}"),
            ("sensed", "the tool's pose by a tracker"),
            ("core", "none" if device.core is None else f"soft sphere of {device.core.radius * 1e3:g} mm"),
        ]
        print_card(device, console, more)
        print_build_checks(device, console)
        print_text(console)
        columns = (
            Column("above contact", "mm", "key"), *(Column(f"peak {axis}", "mN") for axis in _COIL_ARRAY_AXES),
            *(Column(f"continuous {axis}", "mN") for axis in _COIL_ARRAY_AXES), Column("weakest peak", "mN"),
            Column("core's pull", "mN"), Column("heat of 1 N up", "W"),
        )  # fmt: skip
        table = TextTable(
            columns, "Force on the tool over the middle; weakest: worst of six directions and all positions"
        )
        for layer in self._layers:
            forces = (*layer.peak, *layer.lasting, layer.weakest, layer.passive)
            table.add_row(f"{1e3 * layer.height:g}", *(f"{1e3 * force:.0f}" for force in forces), f"{layer.watts:.3g}")
        print_table(console, table)
        contact = self._contact
        weakest, (x, y) = self._layers[0].weakest, (1e3 * at for at in contact.worst_place)
        place = f"at x {x:.0f}, y {y:.0f} mm" if weakest == np.nanmin(contact.weakest) else "on the rim"
        print_text(
            console,
            f"\nin contact, worst of six directions: {1e3 * weakest:.0f} mN {place}; half of the workspace has "
            f"{1e3 * contact.median:.0f} mN or more (--plot draws it)",
        )
        lasting = ", ".join(
            f"{100 * share:.0f} % " + ("unlimited" if math.isinf(seconds) else f"{seconds:.0f} s")
            for share, seconds in self._endurance
        )
        room = device.coils.heat.ambient - 273.15
        print_text(console, f"\nendurance of one coil from {room:.0f} °C by share of full current: {lasting}")
        print_text(
            console,
            "heat: each coil separately. The model has no heat flow between coils; if coils touch or share a core, "
            "expect less continuous force with several warm coils",
        )
        print_text(console, f"assumed: {len(device.assumed)} values (--assumed lists them with their reasons)")

    def quantities(self) -> list[Quantity]:
        """Return the card's quantities for a comparison with other devices, in order."""
        contact = self._layers[0]
        forces = zip(_COIL_ARRAY_AXES, (1e3 * contact.peak).tolist(), strict=True)
        return [
            *common_quantities(self._device),
            *(Quantity(f"peak force along {axis} at contact", "mN", force) for axis, force in forces),
            Quantity("weakest peak force at contact", "mN", 1e3 * contact.weakest),
            Quantity("median weakest peak force at contact", "mN", 1e3 * self._contact.median),
        ]

    def curves(self) -> list[Curve]:
        """Return the card's curves for a comparison with other devices."""
        heights = [1e3 * layer.height for layer in self._layers]
        peaks = 1e3 * np.array([layer.peak for layer in self._layers])
        forces = [
            Curve("Force over the middle", f"peak along {axis}", "above contact [mm]", "force [mN]", heights,
                  peaks[:, k], ("-", "--", ":")[k])
            for k, axis in enumerate(_COIL_ARRAY_AXES)
        ]  # fmt: skip
        return [*forces, *common_curves(self._device)]

    def draw(self) -> Figure:
        """Return the card as a figure."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(15, 4.5), layout="constrained")
        *beside, last = figure.subplots(1, 3)
        places = dict(zip(dict.fromkeys(curve.panel for curve in self.curves()), beside, strict=True))
        for curve in self.curves():
            place = places[curve.panel]
            place.plot(curve.x, curve.y, curve.style, color="C0", label=curve.label)
            place.set_title(curve.panel, loc="left", fontsize=10)
            place.set(xlabel=curve.x_label, ylabel=curve.y_label)
            place.legend(frameon=False, fontsize=8)
        forces = self._contact
        painted = last.pcolormesh(
            1e3 * forces.x, 1e3 * forces.y, 1e3 * forces.weakest, shading="nearest", cmap="viridis", vmin=0.0
        )
        figure.colorbar(painted, ax=last, label="force [mN]")
        last.set_title("Weakest peak force in contact, of six directions", loc="left", fontsize=10)
        last.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
        figure.suptitle(self._device.title, x=0.01, ha="left", fontweight="bold")
        return figure
