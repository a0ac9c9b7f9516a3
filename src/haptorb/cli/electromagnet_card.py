"""Capability card of a spherical electromagnet: force over the shell, endurance, and errors of its published model."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, final

import numpy as np
from rich.console import Console

from haptorb.cli.card import (
    Card,
    Curve,
    Quantity,
    _duration,
    common_curves,
    common_quantities,
    facts,
    print_build_checks,
    print_card,
)
from haptorb.cli.sensing_accuracy import summarize_sensing
from haptorb.devices.base import State
from haptorb.devices.electromagnet import FORCE_JND, SphericalElectromagnet
from haptorb.devices.electromagnet_capability import Layer, shell_capability
from haptorb.devices.feasible_wrench import FeasibleWrench, feasible_wrench
from haptorb.magnetics.wire import wind
from haptorb.terminal import Column, TextTable, print_table, print_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ElectromagnetCard", "print_force_tables"]


# --------------------------------------------------------------------------------------------------
# Tables of the force over the shell: peak, and continuous.


def print_force_tables(console: Console, layers: tuple[Layer, ...], supply: float, *, coupled: bool) -> None:
    """Print peak and continuous force at each of `layers`; coupled coils carry less when all are warm.

    supply: power of the supply [W], inf for no limit.
    """
    peak = TextTable(
        (
            Column("distance", "mm", "key"), Column("peak radial", "mN"), Column("peak tangential", "mN"),
            Column("passive pull", "mN"), Column("dipole error", "%"), Column("dipole error", "JND"),
            Column("coil error", "%"),
        ),
        "Force on a radial tool at the weakest position and direction in the workspace",
    )  # fmt: skip
    for layer in layers:
        peak.add_row(
            f"{layer.distance * 1e3:.0f}", f"{1e3 * layer.peak_radial:.0f}", f"{1e3 * layer.peak_tangential:.0f}",
            f"{1e3 * layer.passive_pull:.1f}", f"{100 * layer.dipole_error:.1f}", f"{layer.dipole_error_jnd:.1f}",
            "–" if layer.coil_error is None else f"{100 * layer.coil_error:.0f}",
        )  # fmt: skip
    print_table(console, peak)
    limit = "" if supply == float("inf") else f"\npeak: within the supply's {supply:g} W, windings hot"
    print_text(
        console,
        "dipole error: largest error of the coils' force if the tool's magnet is a point dipole; its shape alone, "
        f"without the core's pull. JND: just-noticeable difference, {100 * FORCE_JND:.0f} % of force. coil error: of "
        "the force if coils and core are a point too (model point-coils), rms over directions; –: the file has no "
        f"[windings], and the loop takes them for a point{limit}\n",
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
        radial = (layer.continuous_radial, layer.continuous_radial_all_warm)
        tangential = (layer.continuous_tangential, layer.continuous_tangential_all_warm)
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


# --------------------------------------------------------------------------------------------------
# The card.


#: legend position below the axes, clear of the curves
_BELOW: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.16), "frameon": False}


@final
class ElectromagnetCard(Card):
    """Card of an electromagnet: smallest forces over the workspace by the exact model, for a radial tool."""

    _device: SphericalElectromagnet

    def __init__(self, device: SphericalElectromagnet) -> None:
        self._device = device
        self._capability = shell_capability(device)
        self._feasible_wrenches = _feasible_wrenches(device)
        self._predicted = device.predict_moments()

    def numbers(self) -> dict[str, Any]:
        """Return everything on the card as plain JSON types."""
        device, capability = self._device, self._capability
        return {
            **facts(device),
            "sensed_dof": "3 positions and 2 directions by a tracker; the tool's spin is neither rendered nor needed",
            "actuated_dof": 3,
            "field_sensors": device.sensors,
            "workspace_half_angle_deg": math.degrees(device.workspace_half_angle),
            "contact_distance_m": device.contact_distance,
            "shell_m": device.shell_thickness,
            "tool_moment_a_m2": device.tool.moment,
            "moment_per_current_m2": device.moment_per_current.tolist(),
            "moments_from": device.moments_from,
            "predicted_moment_per_current_m2": None if self._predicted is None else self._predicted.tolist(),
            "layers": [
                {
                    "distance_m": layer.distance,
                    "peak_radial_n": layer.peak_radial,
                    "peak_tangential_n": layer.peak_tangential,
                    "continuous_radial_n": layer.continuous_radial,
                    "continuous_tangential_n": layer.continuous_tangential,
                    "continuous_radial_all_warm_n": layer.continuous_radial_all_warm,
                    "continuous_tangential_all_warm_n": layer.continuous_tangential_all_warm,
                    "passive_pull_n": layer.passive_pull,
                    "dipole_error": layer.dipole_error,
                    "dipole_error_jnd": layer.dipole_error_jnd,
                    "coil_error": layer.coil_error,
                }
                for layer in capability.layers
            ],
            "feasible": [
                {
                    "position_m": state.p.tolist(),
                    "force_corners_n": able.force.tolist(),
                    "torque_corners_nm": able.torque.tolist(),
                    "guaranteed_force_n": able.guaranteed_force,
                    "guaranteed_torque_nm": able.guaranteed_torque,
                    "unreachable_torque_axis": able.unreachable.tolist(),
                }
                for state, able in self._feasible_wrenches
            ],
            "endurance": [
                {"share_of_full_current": share, "seconds": seconds if math.isfinite(seconds) else None}
                for share, seconds in capability.endurance
            ],
        }

    def show(self, console: Console) -> None:
        """Print the card on `console`."""
        device, capability = self._device, self._capability
        reach = np.array([device.contact_distance, device.contact_distance + device.shell_thickness]) * 1e3
        more = [
            (
                "workspace",
                f"±{math.degrees(device.workspace_half_angle):.0f}° about the summit, "
                f"{reach[0]:g} to {reach[1]:g} mm from the centre to the tool's magnet",
            ),
            ("actuated", "3 degrees of freedom: force, or torque about two axes, or a compromise of both"),
            ("sensed", f"tool's position and axis (5) by a tracker; {device.sensors} field sensors of 3 axes"),
        ]
        if device.sensors > 1:
            more.append(("by field sensors", summarize_sensing(device)))
        more += _describe_windings(device)
        print_card(device, console, more)
        print_build_checks(device, console)
        print_text(console)
        coupled = device.coils.heat.coupling is not None
        print_force_tables(console, capability.layers, device.supply.power, coupled=coupled)
        able_table = TextTable(
            (
                Column("distance", "mm", "key"), Column("from the summit", "°", "key"), Column("force", "mN"),
                Column("torque", "mN·m"), Column("no torque about"),
            ),
            "Feasible wrench on a radial tool with all coils: smallest over all directions",
        )  # fmt: skip
        for state, able in self._feasible_wrenches:
            polar = math.degrees(math.acos(min(state.p[2] / state.distance, 1.0)))
            able_table.add_row(
                f"{state.distance * 1e3:.0f}",
                f"{polar:.0f}",
                f"{1e3 * able.guaranteed_force:.0f}",
                f"{1e3 * able.guaranteed_torque:.1f}",
                "({:.2f}, {:.2f}, {:.2f})".format(*(able.unreachable.round(6) + 0.0)),
            )
        print_table(console, able_table)
        print_text(console)
        self._moments(console)
        lasting = ", ".join(f"{100 * share:.0f} % {_duration(seconds)}" for share, seconds in capability.endurance)
        room = device.coils.heat.ambient - 273.15
        print_text(console, f"\nendurance of one coil from {room:.0f} °C by share of full current: {lasting}")
        print_text(console, f"assumed: {len(device.assumed)} values (--assumed lists them with their reasons)")

    def _moments(self, console: Console) -> None:
        """Print the moment per ampere: calibrated, and predicted from the coils' dimensions and the core."""
        device = self._device
        origin = {"device file": "in the file", "calibration": "calibrated", "windings": "computed"}
        word = origin[device.moments_from]
        columns = [Column("coil", kind="key"), *(Column(f"{word} {axis}", "m²") for axis in "xyz")]
        compares = self._predicted is not None and device.moments_from != "windings"
        if compares:
            columns += [Column("from its size and the core", "m²"), Column("off by", "%")]
        table = TextTable(tuple(columns), "Moment per ampere along x, y, z")
        for k, name in enumerate(device.coils.names):
            measured = device.moment_per_current[:, k]
            cells = [f"{value:+.4f}" for value in measured]
            if compares and self._predicted is not None:
                predicted = self._predicted[:, k]
                cells += [f"{predicted[k]:+.4f}", f"{100 * (predicted[k] / measured[k] - 1):+.1f}"]
            table.add_row(name, *cells)
        print_table(console, table)
        if device.windings is not None and device.moments_from == "windings":
            print_text(
                console, "computed from [windings] and the core. For accurate forces calibrate the device", "bold"
            )

    def _polytopes(self, axes: Any) -> None:
        """Draw the force polytopes at contact, projected on the x–z plane."""
        from scipy.spatial import ConvexHull

        for n, (state, able) in enumerate(self._feasible_wrenches[:3]):
            flat = 1e3 * able.force[:, [0, 2]]
            outline = flat[ConvexHull(flat).vertices]
            polar = math.degrees(math.acos(min(state.p[2] / state.distance, 1.0)))
            axes.fill(*outline.T, color=f"C{n}", alpha=0.15)
            axes.plot(*np.vstack([outline, outline[:1]]).T, f"C{n}", label=f"{polar:.0f}° from the summit")
        axes.plot(0, 0, "k+")
        axes.set(xlabel="F_x [mN]", ylabel="F_z [mN]", aspect="equal")
        axes.set_title("Feasible force of all coils at contact", loc="left")
        axes.legend(fontsize=8, ncols=3, **_BELOW)
        axes.grid(alpha=0.3)

    def quantities(self) -> list[Quantity]:
        """Return the common quantities, and forces, moments and dimensions of an electromagnet."""
        device, near, far = self._device, self._capability.layers[0], self._capability.layers[-1]
        summit = self._feasible_wrenches[0][1]
        moments = np.linalg.norm(device.moment_per_current, axis=0)
        return [
            *common_quantities(device),
            *(
                Quantity(f"moment per ampere, coil {name}", "m²", float(moment))
                for name, moment in zip(device.coils.names, moments, strict=True)
            ),
            Quantity("moment of the tool", "A·m²", device.tool.moment),
            Quantity("workspace, half angle", "°", math.degrees(device.workspace_half_angle)),
            Quantity("contact distance", "mm", 1e3 * device.contact_distance),
            Quantity("shell", "mm", 1e3 * device.shell_thickness),
            Quantity("peak radial force in contact", "mN", 1e3 * near.peak_radial),
            Quantity("peak tangential force in contact", "mN", 1e3 * near.peak_tangential),
            Quantity("continuous radial in contact, one coil warm", "mN", 1e3 * near.continuous_radial),
            Quantity("continuous tangential in contact, one coil warm", "mN", 1e3 * near.continuous_tangential),
            Quantity("continuous radial in contact, all coils warm", "mN", 1e3 * near.continuous_radial_all_warm),
            Quantity(
                "continuous tangential in contact, all coils warm", "mN", 1e3 * near.continuous_tangential_all_warm
            ),
            Quantity("peak radial force at the shell's end", "mN", 1e3 * far.peak_radial),
            Quantity("passive pull in contact", "mN", 1e3 * near.passive_pull),
            Quantity("force in every direction at the summit", "mN", 1e3 * summit.guaranteed_force),
            Quantity("torque about two axes at the summit", "mN·m", 1e3 * summit.guaranteed_torque),
            Quantity("point-dipole error, tool's magnet in contact", "%", 100 * near.dipole_error),
        ]

    def curves(self) -> list[Curve]:
        """Return force over distance in the weakest direction, and endurance."""
        layers = self._capability.layers
        distance = [1e3 * layer.distance for layer in layers]
        across = "tool's magnet from the centre [mm]"

        def curve(panel: str, label: str, forces: list[float], style: str) -> Curve:
            return Curve(panel, label, across, "force [mN]", distance, [1e3 * force for force in forces], style)

        radial, tangential = "Radial force, weakest position", "Tangential force, weakest position and direction"
        return [
            curve(radial, "peak", [layer.peak_radial for layer in layers], "-"),
            curve(radial, "continuous, one coil warm", [layer.continuous_radial for layer in layers], "--"),
            curve(radial, "continuous, all coils warm", [layer.continuous_radial_all_warm for layer in layers], "-."),
            curve(radial, "passive pull", [layer.passive_pull for layer in layers], ":"),
            curve(tangential, "peak", [layer.peak_tangential for layer in layers], "-"),
            curve(tangential, "continuous, one coil warm", [layer.continuous_tangential for layer in layers], "--"),
            curve(
                tangential,
                "continuous, all coils warm",
                [layer.continuous_tangential_all_warm for layer in layers],
                "-.",
            ),
            *common_curves(self._device),
        ]

    def draw(self) -> Figure:
        """Draw force over distance, and over the dome."""
        from matplotlib.figure import Figure

        layers = self._capability.layers
        distance = [1e3 * layer.distance for layer in layers]
        figure = Figure(figsize=(14, 5.4), layout="constrained")
        left, right, able = figure.subplots(1, 3)
        left.plot(distance, [1e3 * layer.peak_radial for layer in layers], "C0-o", label="radial, peak")
        left.plot(distance, [1e3 * layer.peak_tangential for layer in layers], "C1-s", label="tangential, peak")
        for style, label, radial, tangential in (
            ("--", "continuous, one coil warm", "continuous_radial", "continuous_tangential"),
            ("-.", "continuous, all warm", "continuous_radial_all_warm", "continuous_tangential_all_warm"),
        ):
            left.plot(
                distance, [1e3 * getattr(layer, radial) for layer in layers], f"C0{style}o", label=f"radial, {label}"
            )
            left.plot(
                distance, [1e3 * getattr(layer, tangential) for layer in layers], f"C1{style}s",
                label=f"tangential, {label}",
            )  # fmt: skip
        left.plot(distance, [1e3 * layer.passive_pull for layer in layers], "k:", label="passive pull")
        left.set(xlabel="tool's magnet from the centre [mm]", ylabel="force [mN]", ylim=(0, None))
        left.set_title("Force in the weakest direction", loc="left")
        left.legend(ncols=2, fontsize=8, **_BELOW)
        left.grid(alpha=0.3)
        right.plot(
            distance, [100 * layer.dipole_error for layer in layers], "C3-o",
            label="tool's magnet as a point, largest",
        )  # fmt: skip
        coils = [layer.coil_error for layer in layers if layer.coil_error is not None]
        if len(coils) == len(layers):
            right.plot(
                distance, [100 * error for error in coils], "C4-s",
                label="coils and core as a point, rms: model point-coils",
            )  # fmt: skip
        right.legend(fontsize=8, **_BELOW)
        jnd = right.secondary_yaxis("right", functions=(lambda x: x / (100 * FORCE_JND), lambda x: x * 100 * FORCE_JND))
        jnd.set_ylabel("just-noticeable differences")
        right.axhline(100 * FORCE_JND, color="k", ls=":", lw=1)
        right.annotate("noticeable above this", (distance[0], 100 * FORCE_JND), (0, 4), textcoords="offset points")
        right.set(xlabel="tool's magnet from the centre [mm]", ylabel="error of the coils' force [%]", ylim=(0, None))
        right.set_title("Error of points for magnet and coils", loc="left")
        right.grid(alpha=0.3)
        self._polytopes(able)
        figure.suptitle(self._device.title, x=0.01, ha="left", fontweight="bold")
        return figure


def _describe_windings(device: SphericalElectromagnet) -> list[tuple[str, str]]:
    """Describe the winding of each coil: name and text; empty without [windings]."""
    windings, coils, found = device.windings, device.coils, []
    if windings is None:
        return []
    wires = windings.wires(coils.resistance, coils.copper_resistivity).tolist()
    for name, coil, (copper, overall) in zip(coils.names, windings.coils, wires, strict=True):
        text = f"{coil.turns:g} turns of {copper * 1e3:.3g} mm wire, {overall * 1e3:.3g} mm with its enamel"
        layers = wind(coil.turns, coil.inner_radius, coil.length, overall)
        if layers is not None:
            ohms = layers.resistance(copper, coils.copper_resistivity)
            text += f": {layers.layers} layers of {layers.per_layer}, {layers.wire_length:.3g} m, {ohms:.3g} Ω"
        found.append((f"winding {name}", text))
    return found


def _feasible_wrenches(device: SphericalElectromagnet) -> list[tuple[State, FeasibleWrench]]:
    """List feasible wrenches at the summit, halfway and at the workspace's edge, in contact and at the shell's end."""
    found = []
    for distance in (device.contact_distance, device.contact_distance + device.shell_thickness):
        for polar in np.array([0.0, 0.5, 1.0]) * device.workspace_half_angle:
            state = State.at((distance * math.sin(polar), 0.0, distance * math.cos(polar)))
            found.append((state, feasible_wrench(device, state)))
    return found
