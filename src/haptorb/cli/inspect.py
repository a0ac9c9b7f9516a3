"""A capability card: what a device is, what it can do and what about it is only assumed."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from rich.console import Console

from haptorb.analysis.error_budget import COVERAGE, ErrorBudget, Report, WrenchBand, error_budget
from haptorb.analysis.error_models import error_model
from haptorb.analysis.stability import HandGrip, SampledLoop
from haptorb.analysis.workspace import map_workspaces
from haptorb.arrays import Array
from haptorb.control.capability import array_capability, map_contact, motor_capability
from haptorb.devices.arm import Arm
from haptorb.devices.base import Device, State, device_function, endurance, rotation_to_axis, unsupported
from haptorb.devices.build_checks import BuildCheck, format_bound
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.electromagnet import (
    FORCE_JND,
    FeasibleWrench,
    Layer,
    SphericalElectromagnet,
    electromagnet,
    feasible_wrench,
    shell_capability,
)
from haptorb.devices.field_sensors import SensorErrors
from haptorb.devices.loader import find_device
from haptorb.devices.motor import GRAVITY, SphericalMotor
from haptorb.display import format_number, format_quantity
from haptorb.errors import InputError
from haptorb.estimation.calibration import Calibration
from haptorb.estimation.hall_fit import better_sensors, with_sensors
from haptorb.estimation.hall_tracker import noise_share
from haptorb.estimation.sensor_calibration import (
    SensorKnowledge,
    pose_covariance,
    predict_knowledge,
    shell_sample,
    without_errors,
)
from haptorb.magnetics.wire import wind
from haptorb.notebook import NotebookReport
from haptorb.rotations import rotation_from_euler
from haptorb.terminal import Column, TextTable, print_facts, print_table, print_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "ArmCard",
    "Card",
    "CoilArrayCard",
    "Comparison",
    "Curve",
    "ElectromagnetCard",
    "ErrorReport",
    "MotorCard",
    "Quantity",
    "SensingAccuracy",
    "SensingRow",
    "card",
    "common_curves",
    "common_quantities",
    "compute_row",
    "describe_mappings",
    "facts",
    "name_devices",
    "print_card",
    "print_force_tables",
    "report_errors",
    "sensing_accuracy",
    "sensing_cases",
    "summarize_sensing",
]


# --------------------------------------------------------------------------------------------------
# What cards have in common, so that devices stand side by side: quantities by name, and curves by panel.


@dataclass(frozen=True)
class Quantity:
    """One line of a comparison: what it is, in which unit, and its value for one device."""

    name: str
    unit: str
    value: float

    @property
    def text(self) -> str:
        """The value with three digits.

        >>> Quantity("peak", "mN", 958.71).text, Quantity("endurance", "s", float("inf")).text
        ('959', 'unlimited')
        """
        return "unlimited" if self.value == math.inf else format_number(self.value)

    @property
    def head(self) -> str:
        """Name and unit.

        >>> Quantity("peak", "mN", 958.71).head
        'peak [mN]'
        """
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class Curve:
    """A line in the panel of that title; devices that have a curve of the same panel and label are drawn over another.

    style   dashes as matplotlib writes them: they tell the label, as colours tell the device
    """

    panel: str
    label: str
    x_label: str
    y_label: str
    x: Sequence[float] | Array
    y: Sequence[float] | Array
    style: str = "-"


def common_quantities(device: Device) -> list[Quantity]:
    """What every device has."""
    coils, limits = device.coils, device.limits
    loads = endurance(device, (1.0, 0.5))
    return [
        Quantity("channels", "", device.channels),
        Quantity("peak current", "A", float(device.driven_current.max())),
        Quantity("continuous current", "A", float(device.sustained_current.min())),
        Quantity("continuous current, all coils warm", "A", float(device.sustained_current_together.min())),
        Quantity("resistance, least", "Ω", float(coils.resistance.min())),
        Quantity("resistance, greatest", "Ω", float(coils.resistance.max())),
        Quantity("inductance, greatest", "mH", 1e3 * float(coils.inductance.max())),
        Quantity("supply", "V", device.supply.voltage),
        Quantity("supply's power", "W", device.supply.power),
        Quantity("force limit of the guard", "N", limits.force),
        Quantity("torque limit of the guard", "mN·m", 1e3 * limits.torque),
        Quantity("slew limit", "A/ms", 1e-3 * limits.slew),
        Quantity("field sensors", "", device.sensors),
        *(Quantity(f"endurance at {100 * share:.0f} % current", "s", seconds) for share, seconds in loads),
    ]


def common_curves(device: Device) -> list[Curve]:
    """Endurance over current: every device has it."""
    shares = [1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.25, 0.2]
    loads = [(100 * share, seconds) for share, seconds in endurance(device, tuple(shares)) if math.isfinite(seconds)]
    share, seconds = zip(*loads, strict=True) if loads else ((), ())
    return [
        Curve("Endurance of one channel from room temperature", "until derating", "share of full current [%]",
              "time [s]", share, seconds),
    ]  # fmt: skip


class Card(NotebookReport, ABC):
    """What every card answers."""

    _device: Device

    @property
    def device(self) -> Device:
        """The device whose card this is."""
        return self._device

    @abstractmethod
    def quantities(self) -> list[Quantity]:
        """The figures of the card that stand beside those of other devices, in order."""

    @abstractmethod
    def curves(self) -> list[Curve]:
        """The lines that are drawn over those of other devices."""

    @abstractmethod
    def numbers(self) -> dict[str, Any]:
        """Everything on the card as plain JSON types, SI units in the keys."""

    @abstractmethod
    def show(self, console: Console) -> None:
        """Print it for people."""

    def _summarize(self) -> str:
        return f"<{type(self).__name__} of {self._device.name}: {self._device.title}>"

    @abstractmethod
    def draw(self) -> Figure:
        """The card as a picture."""


@device_function
@singledispatch
def card(device: Device) -> Card:
    """The card of `device`, by its kind. Raises InputError for a kind that has none."""
    raise unsupported(device, "`haptorb inspect`", card)


def facts(device: Device) -> dict[str, Any]:
    """What all devices have, as plain JSON types."""
    coils, told = device.coils, None if device.text is None else device.text.inheritance
    return {
        "name": device.name,
        "title": device.title,
        "source": device.source,
        "digest": device.digest,
        "channels": list(coils.names),
        "current_limit_a": coils.current_limit.tolist(),
        "sustained_current_a": device.sustained_current.tolist(),
        "sustained_current_all_warm_a": device.sustained_current_together.tolist(),
        "resistance_ohm": coils.resistance.tolist(),
        "supply_v": device.supply.voltage,
        "supply_w": device.supply.power if np.isfinite(device.supply.power) else None,
        "limits": {
            "force_n": device.limits.force,
            "torque_nm": device.limits.torque,
            "slew_a_per_s": device.limits.slew,
            "expiry_s": device.limits.expiry,
            "force_rate_n_per_s": device.limits.force_rate,
            "torque_rate_nm_per_s": device.limits.torque_rate,
        },
        "inherited": None
        if told is None
        else {"from": told.base, "own": list(told.own), "dropped": list(told.dropped)},
        "build_checks": [
            {
                "condition": check.condition,
                "of": check.name,
                "unit": check.unit,
                "value": check.value,
                "limit": check.limit,
                "margin": check.margin,
                "holds": check.holds,
                "note": check.note,
            }
            for check in device.build_checks
        ],
        "remarks": list(device.remarks),
        "assumed": dict(device.assumed),
    }


def print_card(device: Device, console: Console, more: Iterable[tuple[str, str]]) -> None:
    """Print the head of the card: title, limits, and `more` facts (name, text)."""
    coils, limits = device.coils, device.limits
    print_text(console, device.title, "bold")
    print_text(console, f"{device.source} · file {device.digest[:12]}\n", "dim")
    peak, hot = device.driven_current, device.supply.voltage / device.greatest_resistance
    same = np.ptp(peak) < 1e-9 * peak[0]
    amperes = f"{peak[0]:.3g} A" if same else ", ".join(f"{a:.3g}" for a in peak) + " A"
    if (hot < peak).any():
        amperes += f" peak at 20 °C, {hot.min():.3g} A hot"
    else:
        amperes += " peak"
    names = ", ".join(coils.names) if device.channels <= 6 else f"{coils.names[0]} … {coils.names[-1]}"
    torque = f"{limits.torque * 1e3:g} mN·m" if limits.torque < 1 else f"{limits.torque:g} N·m"
    guard = f"{limits.force:g} N, {torque}, {limits.slew / 1e3:g} A/ms, poses expire after {limits.expiry * 1e3:g} ms"
    lasting = f"{device.sustained_current.min():.2f} A continuous"
    if coils.heat.coupling is not None:
        lasting += f" with one coil warm, {device.sustained_current_together.min():.2f} A with all coils warm"
    power = "" if np.isinf(device.supply.power) else f", {device.supply.power:g} W for all coils"
    facts = [
        ("channels", f"{device.channels} ({names})"),
        ("current", f"{amperes}, {lasting}"),
        ("coils", f"{coils.resistance.min():.3g} Ω at {coils.reference_temperature - 273.15:.0f} °C"),
        ("supply", f"{device.supply.voltage:g} V{power}, {device.supply.duty_bits}-bit duty"),
        ("guard", guard),
    ]
    told = None if device.text is None else device.text.inheritance
    if told is not None:
        dropped = f"; not from it: {_name_some(told.dropped)}" if told.dropped else ""
        own = f"{len(told.own)} values of its own ({_name_some(told.own)})" if told.own else "no value of its own"
        facts.append(("based on", f"{told.base}, with {own}{dropped}; all others are its base's"))
    print_facts(console, [*facts, *more])
    for remark in device.remarks:
        print_text(console, f"\n{remark[:1].upper()}{remark[1:]}.", "bold red")


def _name_some(keys: tuple[str, ...], most: int = 8) -> str:
    more = f" and {len(keys) - most} more" if len(keys) > most else ""
    return ", ".join(keys[:most]) + more


def print_build_checks(device: Device, console: Console) -> None:
    """What must hold for `device` to be buildable: of each condition the part with the least margin."""
    nearest: dict[str, BuildCheck] = {}
    for check in device.build_checks:
        known = nearest.setdefault(check.condition, check)
        if check.margin / (abs(check.limit) or 1.0) < known.margin / (abs(known.limit) or 1.0):
            nearest[check.condition] = check
    holds = all(check.holds for check in nearest.values())
    table = TextTable(
        (
            Column("condition", kind="key"), Column("value"), Column("limit"), Column("margin"),
            Column("part", kind="note"),
        ),
        f"{'It can be built' if holds else 'It cannot be built'}: of each condition, the part with the least margin",
    )  # fmt: skip
    for condition, check in nearest.items():
        limit = f"{'≥' if check.at_least else '≤'} {format_bound(check.limit, check.unit)}"
        margin = format_bound(max(check.margin, 0.0), check.unit) if check.holds else "NOT KEPT"
        table.add_row(condition, format_bound(check.value, check.unit), limit, margin, check.name)
    print_text(console)
    print_table(console, table)


# --------------------------------------------------------------------------------------------------
# The card of a coil array: force along each axis by height, the weakest place, and the heat of a newton.


_COIL_ARRAY_AXES = ("x", "y", "z")


@card.register(CoilArray)
@final
class CoilArrayCard(Card):
    """Forces are those of the exact model on a tool held upright, over a dome radially; a torque accompanies them."""

    _device: CoilArray

    def __init__(self, device: CoilArray) -> None:
        self._device = device
        self._contact = map_contact(device)
        contact, *above = array_capability(device)
        weakest = min(
            contact.weakest, float(np.nanmin(self._contact.weakest))
        )  # each has places that the other has not
        self._layers = (replace(contact, weakest=weakest), *above)
        self._endurance = endurance(device)

    def numbers(self) -> dict[str, Any]:
        """Everything on the card as plain JSON types."""
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
        """Print it for people."""
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
        """The figures of the card that stand beside those of other devices, in order."""
        contact = self._layers[0]
        forces = zip(_COIL_ARRAY_AXES, (1e3 * contact.peak).tolist(), strict=True)
        return [
            *common_quantities(self._device),
            *(Quantity(f"peak force along {axis} at contact", "mN", force) for axis, force in forces),
            Quantity("weakest peak force at contact", "mN", 1e3 * contact.weakest),
            Quantity("median weakest peak force at contact", "mN", 1e3 * self._contact.median),
        ]

    def curves(self) -> list[Curve]:
        """The lines that are drawn over those of other devices."""
        heights = [1e3 * layer.height for layer in self._layers]
        peaks = 1e3 * np.array([layer.peak for layer in self._layers])
        forces = [
            Curve("Force over the middle", f"peak along {axis}", "above contact [mm]", "force [mN]", heights,
                  peaks[:, k], ("-", "--", ":")[k])
            for k, axis in enumerate(_COIL_ARRAY_AXES)
        ]  # fmt: skip
        return [*forces, *common_curves(self._device)]

    def draw(self) -> Figure:
        """The card as a picture."""
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


# --------------------------------------------------------------------------------------------------
# The card of a haptic arm: what it gives, weighs and senses, and how stiff a wall it renders.


@card.register(Arm)
@final
class ArmCard(Card):
    """Forces are the same everywhere in the workspace; stiffness limits are those of a loop of 1 kHz."""

    _device: Arm

    def __init__(self, device: Arm) -> None:
        self._device = device
        coils = device.coils
        self._loop = SampledLoop.of(1000.0, time_constant=float(np.max(coils.inductance / coils.resistance)))
        hand = device.hand
        self._grip = HandGrip(device.effector.mass + hand.mass, device.effector.viscous + hand.damping, hand.stiffness)
        self._endurance = endurance(device)

    def numbers(self) -> dict[str, Any]:
        """Everything on the card as plain JSON types."""
        device = self._device
        effector, encoder, gripper = device.effector, device.encoder, device.gripper
        peak, lasting = device.greatest_wrench, device.continuous_wrench
        return {
            **facts(device),
            "sensed_dof": 3 if effector.orientation == "fixed" else 6,
            "actuated_dof": device.channels,
            "workspace_shape": device.workspace.shape,
            "workspace_half_m": list(device.workspace.half),
            "peak_force_n": peak[0],
            "continuous_force_n": lasting[0],
            "peak_torque_nm": peak[1],
            "continuous_torque_nm": lasting[1],
            "apparent_mass_kg": effector.mass,
            "dry_friction_n": effector.coulomb,
            "viscous_friction_n_s_per_m": effector.viscous,
            "encoder_step_m": encoder.step,
            "encoder_turn_step_rad": encoder.turn_step,
            "specified_stiffness_n_per_m": device.stiffness_limit,
            "passive_stiffness_n_per_m": self._passive,
            "stable_stiffness_n_per_m": self._stable,
            "gripper": None if gripper is None else {"opening_m": gripper.opening, "force_n": gripper.force},
            "endurance": [
                {"share_of_full_current": share, "seconds": seconds if math.isfinite(seconds) else None}
                for share, seconds in self._endurance
            ],
        }

    @property
    def _passive(self) -> float:
        """Largest passive stiffness with the hand's damping: 2b/T (Colgate and Schenkel 1997) [N/m]."""
        return self._loop.passive_bound(self._grip.damping)

    @property
    def _stable(self) -> float:
        """Largest stable stiffness with the hand of the file, lag included [N/m]."""
        return self._loop.largest(self._grip)

    def show(self, console: Console) -> None:
        """Print it for people."""
        device = self._device
        effector, encoder, gripper = device.effector, device.encoder, device.gripper
        turned = {
            "fixed": "fixed", "sensed": "turns freely, sensed", "actuated": "sensed and actuated",
        }[effector.orientation]  # fmt: skip
        sensed = f"positions in steps of {1e3 * encoder.step:g} mm"
        if encoder.turn_step:
            sensed += f", rotation in steps of {math.degrees(encoder.turn_step):.3g}°"
        more = [
            ("workspace", device.workspace.describe()),
            ("orientation", turned),
            (
                "end effector",
                f"{1e3 * effector.mass:g} g, friction {effector.coulomb:g} N and {effector.viscous:g} N·s/m",
            ),
            ("encoders", f"{sensed}; velocity over {1e3 * encoder.velocity_window:g} ms"),
            ("gripper", "none" if gripper is None else f"{1e3 * gripper.opening:g} mm, {gripper.force:g} N"),
        ]
        print_card(device, console, more)
        print_build_checks(device, console)
        print_text(console)
        table = TextTable((Column("", kind="key"), Column("peak"), Column("continuous")), "At the end effector")
        (force, torque), (lasting, turning) = device.greatest_wrench, device.continuous_wrench
        table.add_row("force [N]", f"{force:.3g}", f"{lasting:.3g}")
        if device.is_turned:
            table.add_row("torque [mN·m]", f"{1e3 * torque:.3g}", f"{1e3 * turning:.3g}")
        print_table(console, table)
        print_text(
            console,
            f"\nstiffness: {device.stiffness_limit:g} N/m specified; at 1 kHz {self._passive:.4g} N/m are passive "
            f"(2b/T), {self._stable:.4g} N/m stable with a hand of {device.hand.damping:g} N·s/m and the motors' lag",
        )
        lasts = ", ".join(
            f"{100 * share:.0f} % " + ("unlimited" if math.isinf(seconds) else f"{seconds:.0f} s")
            for share, seconds in self._endurance
        )
        print_text(console, f"endurance of one motor by share of full current: {lasts}")
        print_text(
            console,
            "left out: kinematics; mass, friction and force are the same everywhere. Gravity is compensated",
        )
        print_text(console, f"assumed: {len(device.assumed)} values (--assumed lists them with their reasons)")

    def quantities(self) -> list[Quantity]:
        """The figures of the card that stand beside those of other devices, in order."""
        device = self._device
        peak, lasting = device.greatest_wrench, device.continuous_wrench
        half = [2e3 * side for side in device.workspace.half]
        return [
            *common_quantities(device),
            Quantity("peak force along an axis", "N", peak[0]),
            Quantity("continuous force along an axis", "N", lasting[0]),
            Quantity("peak torque about an axis", "mN·m", 1e3 * peak[1]),
            *(Quantity(f"workspace along {axis}", "mm", side) for axis, side in zip("xyz", half, strict=True)),
            Quantity("apparent mass", "g", 1e3 * device.effector.mass),
            Quantity("dry friction", "N", device.effector.coulomb),
            Quantity("encoder step", "mm", 1e3 * device.encoder.step),
            Quantity("specified stiffness", "N/m", device.stiffness_limit),
            Quantity("passive stiffness at 1 kHz", "N/m", self._passive),
        ]

    def curves(self) -> list[Curve]:
        """The lines that are drawn over those of other devices."""
        return common_curves(self._device)

    def draw(self) -> Figure:
        """The card as a picture."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(10, 4.2), layout="constrained")
        left, right = figure.subplots(1, 2)
        for curve in self.curves():
            left.plot(curve.x, curve.y, curve.style, label=curve.label)
            left.set(xlabel=curve.x_label, ylabel=curve.y_label)
            left.set_title(curve.panel, loc="left", fontsize=10)
        damping = np.geomspace(0.1, 20.0, 41)
        right.loglog(damping, [self._loop.passive_bound(one) for one in damping], "k:", label="passive: 2b/T")
        right.loglog(
            damping,
            [self._loop.largest(replace(self._grip, damping=float(one))) for one in damping],
            "C2",
            label="stable with the hand of the file, exact",
        )
        right.axhline(self._device.stiffness_limit, color="C1", ls="--", label="specified")
        right.set(xlabel="damping of arm and hand [N·s/m]", ylabel="largest stiffness [N/m]")
        right.set_title("Stiffness at 1 kHz", loc="left", fontsize=10)
        right.legend(frameon=False, fontsize=8)
        figure.suptitle(self._device.title, x=0.01, ha="left", fontweight="bold")
        return figure


# --------------------------------------------------------------------------------------------------
# Several devices beside each other: one row per quantity, one column per device, and their curves over each other.


#: Okabe and Ito's colours, distinguished with any colour vision, and a marker for each
_LINES = (
    *(("#0072b2", "o"), ("#d55e00", "s"), ("#009e73", "D"), ("#cc79a7", "^"), ("#e69f00", "v"), ("#56b4e9", "P")),
    ("#000000", "X"),
)
_MISSING = "-"  #: of a quantity that a kind of device does not have
_CHANGE = 1e-6  #: relative; below it, two devices are alike


@final
class Comparison(NotebookReport):
    """Cards of several devices; `labels` are their names in tables and legends."""

    def __init__(self, cards: Sequence[Card], labels: Sequence[str]) -> None:
        if len(cards) > len(_LINES):
            raise InputError(f"at most {len(_LINES)} devices can be compared at once; got {len(cards)}")
        self.cards, self.labels = tuple(cards), tuple(labels)
        self._columns = [{one.head: one for one in card.quantities()} for card in cards]

    def numbers(self) -> list[dict[str, Any]]:
        """Every card as plain JSON types, in the order of the devices."""
        return [card.numbers() for card in self.cards]

    def show(self, console: Console) -> None:
        """Print it for people: the devices, then the quantities in which they may differ."""
        devices = [card.device for card in self.cards]
        facts = [
            (label, f"{device.kind.title} · {device.title} · {device.source} · file {device.digest[:12]}")
            for label, device in zip(self.labels, devices, strict=True)
        ]
        print_facts(console, facts)
        print_text(console)
        two = len(self.cards) == 2 and devices[0].kind.name == devices[1].kind.name
        columns = [Column("quantity", kind="key"), *(Column(label) for label in self.labels)]
        if two:
            columns.append(Column("change", "%"))
        table = TextTable(tuple(columns), "Capability side by side")
        heads = self._list_heads()
        for head in heads:
            cells = [column.get(head) for column in self._columns]
            texts = [_MISSING if cell is None else cell.text for cell in cells]
            table.add_row(head, *texts, *([_change(*cells)] if two else []))
        print_table(console, table)
        for line in describe_mappings(devices, self.labels):
            print_text(console, line)
        if len({device.digest for device in devices}) < len(devices):
            print_text(console, '\nDevices with the same number after "file" are the same in every value.')
        if any(len(column) < len(heads) for column in self._columns):
            print_text(console, f"\n{_MISSING}: this kind of device does not have the quantity", "dim")

    def _list_heads(self) -> list[str]:
        """Quantities of all devices, each once: those of every kind first."""
        heads = list(dict.fromkeys(head for column in self._columns for head in column))
        return sorted(heads, key=lambda head: not all(head in column for column in self._columns))

    def draw(self) -> Figure:
        """The curves of all devices over each other, one panel for each quantity that at least one of them has."""
        from matplotlib.figure import Figure
        from matplotlib.lines import Line2D

        panels: dict[str, list[tuple[int, Curve]]] = {}
        for number, card in enumerate(self.cards):
            for curve in card.curves():
                panels.setdefault(curve.panel, []).append((number, curve))
        across = min(len(panels), 3)
        down = -(-len(panels) // across)
        figure = Figure(figsize=(5.2 * across, 4.2 * down + 0.6), layout="constrained")
        places = figure.subplots(down, across, squeeze=False).ravel()
        for place, (title, curves) in zip(places, panels.items(), strict=False):
            _draw_panel(place, title, curves)
        for place in places[len(panels) :]:
            place.axis("off")
        lines = [Line2D([], [], color=color, marker=marker) for color, marker in _LINES[: len(self.cards)]]
        figure.legend(lines, self.labels, loc="outside upper left", ncols=len(lines), frameon=False)
        return figure

    def _summarize(self) -> str:
        return f"<Comparison of {', '.join(self.labels)}>"


def describe_mappings(devices: Sequence[Device], labels: Sequence[str]) -> list[str]:
    """The default mapping of the first device's workspace into that of each other one of another size, a line each.

    >>> from haptorb.devices.loader import load
    >>> describe_mappings([load("arm"), load("arm")], ["one", "two"])
    []
    """
    found = []
    for other, label in zip(devices[1:], labels[1:], strict=True):
        mapping = map_workspaces(devices[0], other)
        if mapping is None or (abs(mapping.scale - 1.0) < 1e-3 and np.allclose(mapping.centre, mapping.other_centre)):
            continue
        middle, there = (
            f"({', '.join(f'{round(1e3 * x) + 0:g}' for x in one)}) mm"
            for one in (mapping.centre, mapping.other_centre)
        )
        found.append(
            f"\nworkspace of {labels[0]} in that of {label}: middle {middle} onto {there}, scale {mapping.scale:.3g}; "
            f"a stiffness of {labels[0]} seems {1 / mapping.scale:.3g} times as large there"
        )
    return found


def _draw_panel(place: Any, title: str, curves: list[tuple[int, Curve]]) -> None:
    from matplotlib.lines import Line2D

    kinds: dict[str, str] = {}
    for number, curve in curves:
        color, marker = _LINES[number]
        place.plot(curve.x, curve.y, color=color, marker=marker, ms=4, ls=curve.style, label=f"{number}: {curve.label}")
        kinds[curve.label] = curve.style
    first = curves[0][1]
    place.set(xlabel=first.x_label, ylabel=first.y_label)
    place.set_title(title, loc="left", fontsize=10)
    place.grid(alpha=0.3)
    if any(len(curve.y) for _, curve in curves):
        place.set_ylim(0, None)
    if len(kinds) > 1:
        signs = [Line2D([], [], color="0.3", ls=style) for style in kinds.values()]
        place.legend(signs, kinds, frameon=False, fontsize=8)


def _change(before: Quantity | None, after: Quantity | None) -> str:
    """From the first device to the second, in per cent; nothing for what only one of them has."""
    if before is None or after is None:
        return ""
    if before.value == after.value:
        return "0"
    relative = after.value / before.value - 1 if before.value else float("nan")
    if not abs(relative) < float("inf"):
        return ""
    return (
        "0" if abs(relative) < _CHANGE else f"{100 * relative:+.0f}" if abs(relative) >= 1 else f"{100 * relative:+.3g}"
    )


def name_devices(devices: Sequence[Device], given: Sequence[str]) -> list[str]:
    """A label for each device: its name, or what was `given` where another has that name too.

    Raises InputError for what is given twice.
    """
    for number, one in enumerate(given):
        if one in given[:number]:
            raise InputError(f"device '{one}' is given twice; give every device once")
    names = [device.name for device in devices]
    return [name if names.count(name) == 1 else text for name, text in zip(names, given, strict=True)]


# --------------------------------------------------------------------------------------------------
# The tables of a spherical electromagnet's force over its shell: at the peak, and without a time limit.


def print_force_tables(console: Console, layers: tuple[Layer, ...], supply: float, *, coupled: bool) -> None:
    """Print what the coils can do at each of `layers`; coupled ones last less when all are warm.

    supply: its power [W], inf for no limit.
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


# --------------------------------------------------------------------------------------------------
# How well the field sensors tell where the tool is, and what force that costs: `haptorb inspect DEVICE --sensing`.


ASKED = 0.3  #: force that is asked [N]
_EDDY_FREQUENCY = 50.0  #: at which the core's lag is stated [Hz]
_STEEL = (0.03, 0.12)  #: radius of a steel ball, and how far it is from the centre, anywhere but above [m]
_MOMENTS = 3e-3  #: of the moment map's entries after the step `magnetic`, relative, with sensors that are 1 % off
_DRAWS = 6  #: of a wrong pose at each place


@dataclass(frozen=True)
class SensingCase:
    """One state of knowledge of one device's sensors."""

    name: str
    device: SphericalElectromagnet
    knowledge: SensorKnowledge


@dataclass(frozen=True)
class SensingRow:
    """Root mean squares over the shell: tool held radially, all coils at `current` [A]."""

    name: str
    current: float  #: [A]
    place: float  #: error of the tool's place, tracker [m]
    axis: float  #: error of its axis, tracker [rad]
    bound: float  #: least possible error of the place, Cramér and Rao [m]
    force: float  #: error of the force that is given when 0.3 N are asked [N]
    jnd: float  #: the same in just-noticeable differences


@dataclass(frozen=True)
class SensingAccuracy:
    """The table of one device."""

    device: str
    rows: tuple[SensingRow, ...]

    def row(self, name: str, current: float) -> SensingRow:
        """The row of these."""
        return next(row for row in self.rows if (row.name, row.current) == (name, current))

    def numbers(self) -> dict[str, Any]:
        """Plain JSON types, units in the keys."""
        return {
            "device": self.device,
            "asked_n": ASKED,
            "rows": [
                {
                    "case": row.name,
                    "current_a": row.current,
                    "place_m": row.place,
                    "axis_deg": math.degrees(row.axis),
                    "place_bound_m": row.bound,
                    "force_n": row.force,
                    "force_jnd": row.jnd,
                }
                for row in self.rows
            ],
        }

    def show(self, console: Console) -> None:
        """Print it for people."""
        table = TextTable(
            (
                Column("lasting errors", kind="key"), Column("coils", "A"), Column("place", "mm"), Column("axis", "°"),
                Column("least place", "mm"), Column("force", "mN"), Column("force", "JND"),
            ),
            "Tool by the field sensors: errors over the shell, rms, first order",
        )  # fmt: skip
        for row in self.rows:
            table.add_row(
                row.name, f"{row.current:.0f}", f"{1e3 * row.place:.2f}", f"{math.degrees(row.axis):.2f}",
                f"{1e3 * row.bound:.2f}", f"{1e3 * row.force:.1f}", f"{row.jnd:.2f}",
            )  # fmt: skip
        print_table(console, table)
        print_text(
            console,
            f"Noise is in every row, filtered to 100 Hz at 1 kHz. force: of {1e3 * ASKED:.0f} mN asked in any "
            f"direction. JND: just-noticeable difference, {100 * FORCE_JND:.0f} % of force. least: Cramér-Rao bound. "
            "Errors as in the device file; a row that names one error has only that error.",
            "dim",
        )


def sensing_accuracy(device: Device) -> SensingAccuracy:
    """The table of `device`; InputError for one whose field sensors do not locate a tool."""
    located = electromagnet(device, "`haptorb inspect --sensing`")
    if located.sensors < 2:
        raise InputError(
            f"device '{device.name}' has {located.sensors} field sensors; at least two are needed to locate a tool"
        )
    currents = (0.0, float(device.driven_current.min()))
    rows = [compute_row(case, current) for case in sensing_cases(located) for current in currents]
    return SensingAccuracy(device.name, tuple(rows))


def summarize_sensing(device: SphericalElectromagnet) -> str:
    """One line for the card: all errors of the device file, coils at full current, before and after calibration."""
    current = float(device.driven_current.min())
    wanted = ("all, not calibrated", "all, calibrated: sensors")
    before, after = (compute_row(case, current) for case in sensing_cases(device, readings=120) if case.name in wanted)
    return (
        f"position {1e3 * after.place:.1f} mm, axis {math.degrees(after.axis):.1f}°, force {1e3 * after.force:.0f} mN "
        f"({after.jnd:.1f} JND) rms over the shell at {current:.0f} A after `haptorb calibrate`, "
        f"{1e3 * before.place:.1f} mm before; --sensing lists the errors"
    )


def sensing_cases(device: SphericalElectromagnet, readings: int = 360) -> Iterator[SensingCase]:
    """What is tried: each error alone, and all of them before and after each step of a calibration.

    readings: of the tool, in the step `sensors`.
    """
    k, errors, core = device.sensors, device.hall.errors, device.core_dynamics
    heat = device.coils.heat
    warmth = device.hall.warming * (heat.derate - heat.ambient)
    drift = (errors.offset_drift * warmth, errors.gain_drift * warmth)
    eddy = core.spread * core.lag(_EDDY_FREQUENCY)
    none, ideal = SensorErrors(), without_errors(device)
    yield SensingCase("none: noise and quantisation only", ideal, SensorKnowledge.of(none, k))
    for name, text in (
        ("offset", f"offset {1e3 * errors.offset:g} mT"),
        ("gain", f"gain {100 * errors.gain:g} %"),
        ("cross", f"cross-axis {100 * errors.cross:g} %"),
        ("placement", f"placement {1e3 * errors.placement:g} mm"),
        ("angle", f"angle {math.degrees(errors.angle):.2g}°"),
    ):
        alone = replace(none, **{name: getattr(errors, name)})
        yield SensingCase(text, ideal, SensorKnowledge.of(alone, k))
    yield SensingCase(f"drift over {warmth:.0f} K", ideal, replace(SensorKnowledge.of(none, k), drift=drift))
    yield SensingCase("remanence", device, replace(SensorKnowledge.of(none, k), remanent=core.remanent_moment))
    yield SensingCase(
        f"core's lag {100 * core.spread:.0f} % off, currents at {_EDDY_FREQUENCY:.0f} Hz", device,
        replace(SensorKnowledge.of(none, k), eddy=eddy),
    )  # fmt: skip
    earth = 0.0 if device.tolerance is None else device.tolerance.earth_field / math.sqrt(3)
    if earth:
        text = f"earth's field {format_quantity(math.sqrt(3) * earth, 'T')}, in any direction"
        yield SensingCase(text, ideal, replace(SensorKnowledge.of(none, k), uniform=earth))
    radius, away = _STEEL
    text = f"steel ball of {1e3 * radius:.0f} mm radius, {1e3 * away:.0f} mm away"
    yield SensingCase(text, ideal, replace(SensorKnowledge.of(none, k), steel=_STEEL))
    rest = {"drift": drift, "remanent": core.remanent_moment}
    every = SensorKnowledge.of(errors, k, uniform=earth)
    yield SensingCase("all, not calibrated", device, replace(every, **rest))  # type: ignore[arg-type]
    known = SensorKnowledge.of(replace(errors, offset=0.0), k, moments=_MOMENTS)
    yield SensingCase("all, calibrated: magnetic", device, replace(known, **rest))  # type: ignore[arg-type]
    found = predict_knowledge(device, readings)
    part = replace(known, coils=found.coils)
    yield SensingCase("all, calibrated: fields", device, replace(part, **rest))  # type: ignore[arg-type]
    yield SensingCase("all, calibrated: sensors", device, replace(found, **rest))  # type: ignore[arg-type]
    moving = replace(found, **rest, eddy=eddy)  # type: ignore[arg-type]
    yield SensingCase(f"the same, currents at {_EDDY_FREQUENCY:.0f} Hz", device, moving)
    if k == len(better_sensors(device)):
        ringed = with_sensors(device, better_sensors(device))
        there = replace(predict_knowledge(ringed, readings), **rest)  # type: ignore[arg-type]
        yield SensingCase("all, calibrated: sensors, in two rings", ringed, there)


def compute_row(case: SensingCase, current: float) -> SensingRow:
    """Root mean squares over the shell for `case`, all coils at `current` [A]."""
    device = case.device
    currents = np.full(device.channels, current)
    places, weights = shell_sample(device)
    squares = np.zeros(4)
    draw = np.random.default_rng(0)
    for p, weight in zip(places, weights, strict=True):
        reached, bound = pose_covariance(device, p, p, currents, case.knowledge, noise_share())
        force = _force_error(device, p, reached, draw)
        squares += weight * np.array(
            [np.trace(reached[:3, :3]), np.trace(reached[3:, 3:]), np.trace(bound[:3, :3]), force]
        )
    place, axis, least, force_rms = np.sqrt(squares).tolist()
    return SensingRow(case.name, current, place, axis, least, force_rms, force_rms / (FORCE_JND * ASKED))


def _force_error(device: SphericalElectromagnet, p: Array, covariance: Array, draw: np.random.Generator) -> float:
    """Mean square [N²] of the error of the force given at p (3,) [m], radial tool, where the pose is wrong."""
    R = rotation_to_axis(p)
    true = device.wrench_map(_state(p, R), device.models[0])
    root = np.linalg.cholesky(covariance + 1e-18 * np.eye(5))
    total = 0.0
    for _ in range(_DRAWS):
        wrong = root @ draw.standard_normal(5)
        axis = R[:, 2] + wrong[3] * np.cross(R[:, 0], R[:, 2]) + wrong[4] * np.cross(R[:, 1], R[:, 2])
        believed = device.wrench_map(_state(p + wrong[:3], rotation_to_axis(axis)), device.models[0])
        asked = draw.standard_normal(3)
        asked *= ASKED / np.linalg.norm(asked)
        currents = np.linalg.lstsq(believed.matrix[:3], asked - believed.passive[:3], rcond=None)[0]
        given = true.matrix[:3] @ currents + true.passive[:3]
        total += float(((given - asked) ** 2).sum())
    return total / _DRAWS


def _state(p: Array, R: Array) -> State:
    return State(0.0, R, np.ascontiguousarray(p), np.zeros(3), np.zeros(3))


# --------------------------------------------------------------------------------------------------
# The card of a spherical electromagnet: force over the shell, endurance, and what its published model gets wrong.


#: of a legend: below the axes, where no line runs through it
_BELOW: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.16), "frameon": False}


@card.register(SphericalElectromagnet)
@final
class ElectromagnetCard(Card):
    """Forces are the least over the workspace, by the exact model, for a tool held radially."""

    _device: SphericalElectromagnet

    def __init__(self, device: SphericalElectromagnet) -> None:
        self._device = device
        self._capability = shell_capability(device)
        self._feasible_wrenches = _feasible_wrenches(device)
        self._predicted = device.predict_moments()

    def numbers(self) -> dict[str, Any]:
        """Everything on the card as plain JSON types."""
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
                    "continuous_radial_n": layer.lasting_radial,
                    "continuous_tangential_n": layer.lasting_tangential,
                    "continuous_radial_all_warm_n": layer.lasting_radial_all_warm,
                    "continuous_tangential_all_warm_n": layer.lasting_tangential_all_warm,
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
        """Print it for people."""
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
        """m_e per ampere: as calibrated, and as the coils' sizes and the core would have it."""
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
        """Shadows of the force polytopes at contact on the x–z plane."""
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
        """Those of every device, and force, moments and places of an electromagnet."""
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
            Quantity("continuous radial in contact, one coil warm", "mN", 1e3 * near.lasting_radial),
            Quantity("continuous tangential in contact, one coil warm", "mN", 1e3 * near.lasting_tangential),
            Quantity("continuous radial in contact, all coils warm", "mN", 1e3 * near.lasting_radial_all_warm),
            Quantity("continuous tangential in contact, all coils warm", "mN", 1e3 * near.lasting_tangential_all_warm),
            Quantity("peak radial force at the shell's end", "mN", 1e3 * far.peak_radial),
            Quantity("passive pull in contact", "mN", 1e3 * near.passive_pull),
            Quantity("force in every direction at the summit", "mN", 1e3 * summit.guaranteed_force),
            Quantity("torque about two axes at the summit", "mN·m", 1e3 * summit.guaranteed_torque),
            Quantity("point-dipole error, tool's magnet in contact", "%", 100 * near.dipole_error),
        ]

    def curves(self) -> list[Curve]:
        """Force over distance in the weakest direction, and endurance."""
        layers = self._capability.layers
        distance = [1e3 * layer.distance for layer in layers]
        across = "tool's magnet from the centre [mm]"

        def curve(panel: str, label: str, forces: list[float], style: str) -> Curve:
            return Curve(panel, label, across, "force [mN]", distance, [1e3 * force for force in forces], style)

        radial, tangential = "Radial force, weakest position", "Tangential force, weakest position and direction"
        return [
            curve(radial, "peak", [layer.peak_radial for layer in layers], "-"),
            curve(radial, "continuous, one coil warm", [layer.lasting_radial for layer in layers], "--"),
            curve(radial, "continuous, all coils warm", [layer.lasting_radial_all_warm for layer in layers], "-."),
            curve(radial, "passive pull", [layer.passive_pull for layer in layers], ":"),
            curve(tangential, "peak", [layer.peak_tangential for layer in layers], "-"),
            curve(tangential, "continuous, one coil warm", [layer.lasting_tangential for layer in layers], "--"),
            curve(
                tangential, "continuous, all coils warm", [layer.lasting_tangential_all_warm for layer in layers], "-."
            ),
            *common_curves(self._device),
        ]

    def draw(self) -> Figure:
        """Force over distance, and over the dome."""
        from matplotlib.figure import Figure

        layers = self._capability.layers
        distance = [1e3 * layer.distance for layer in layers]
        figure = Figure(figsize=(14, 5.4), layout="constrained")
        left, right, able = figure.subplots(1, 3)
        left.plot(distance, [1e3 * layer.peak_radial for layer in layers], "C0-o", label="radial, peak")
        left.plot(distance, [1e3 * layer.peak_tangential for layer in layers], "C1-s", label="tangential, peak")
        for style, label, radial, tangential in (
            ("--", "continuous, one coil warm", "lasting_radial", "lasting_tangential"),
            ("-.", "continuous, all warm", "lasting_radial_all_warm", "lasting_tangential_all_warm"),
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
    """How each coil is wound: name and text; nothing without [windings]."""
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
    """At the summit, halfway and at the workspace's edge, in contact and at the shell's end."""
    found = []
    for distance in (device.contact_distance, device.contact_distance + device.shell_thickness):
        for polar in np.array([0.0, 0.5, 1.0]) * device.workspace_half_angle:
            state = State.at((distance * math.sin(polar), 0.0, distance * math.cos(polar)))
            found.append((state, feasible_wrench(device, state)))
    return found


def _duration(seconds: float) -> str:
    if math.isinf(seconds):
        return "unlimited"
    return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"


# --------------------------------------------------------------------------------------------------
# `haptorb inspect DEVICE --errors`: in which band the delivered wrench lies, and what contributes most to it.


_KEYS = {"N": "n", "N·m": "nm"}
_ROUNDING = 1e-6  #: [mN or mN·m]
_LEAST = 5e-4  #: share of the variance below which a bar is not drawn


@final
class ErrorReport(NotebookReport):
    """An error budget as text, as numbers and as a picture."""

    def __init__(self, device: Device, budget: ErrorBudget) -> None:
        self.device, self.budget = device, budget

    def numbers(self) -> dict[str, Any]:
        """Everything as plain JSON types, SI units in the keys."""
        budget, unit = self.budget, _KEYS[self.budget.unit]
        return {
            "name": budget.device,
            "digest": self.device.digest,
            "estimator": budget.estimator,
            f"asked_{unit}": budget.asked,
            "motion": budget.motion,
            "jnd": budget.jnd,
            "coverage": COVERAGE,
            "samples": budget.samples,
            "seed": budget.seed,
            "regions": [
                {
                    "region": band.region,
                    f"size_{unit}": band.size,
                    "size_jnd": budget.count_jnd(band.size),
                    "components": [
                        {
                            "component": name,
                            f"low_{unit}": float(band.low[n]),
                            f"high_{unit}": float(band.high[n]),
                            f"standard_uncertainty_{unit}": float(band.standard[n]),
                        }
                        for n, name in enumerate(budget.components)
                    ],
                }
                for band in budget.bands
            ],
            "sources": [
                {
                    "source": share.name,
                    "standard_uncertainty": share.standard,
                    "origin": share.origin,
                    f"alone_{unit}": share.alone,
                    "first_order": share.first_order,
                    "first_order_interval": list(share.first_order_interval),
                    "total": share.total,
                    "total_interval": list(share.total_interval),
                }
                for share in budget.shares
            ],
            "left_out": budget.left_out,
        }

    def show(self, console: Console) -> None:
        """Print it for people."""
        budget, unit = self.budget, f"m{self.budget.unit}"
        print_text(console, f"Error budget of {self.device.title}", "bold")
        facts = [
            ("asked", f"{1e3 * budget.asked:g} {unit} in any direction, {budget.motion}, anywhere in the workspace"),
            ("source of the pose", budget.estimator),
            ("propagation", f"Monte Carlo over {budget.samples} devices, seed {budget.seed}"),
        ]
        print_facts(console, facts)
        print_text(console)
        bands = TextTable(
            (
                Column("region", kind="text"),
                *(Column(name, unit, "short") for name in budget.components),
                Column("size", unit), Column("size", "JND"),
            ),
            f"{100 * COVERAGE:.0f} % of the devices deliver the wrench within",
        )  # fmt: skip
        for band in budget.bands:
            spans = (f"{1e3 * band.low[n]:+.2g} … {1e3 * band.high[n]:+.2g}" for n in range(len(budget.components)))
            bands.add_row(band.region, *spans, f"{1e3 * band.size:.3g}", f"{budget.count_jnd(band.size):.2f}")
        print_table(console, bands)
        print_text(
            console, f"size: length of the error vector. JND: {100 * budget.jnd:.3g} % of the wrench asked\n", "dim"
        )
        sources = TextTable(
            (
                Column("source", kind="text"), Column("standard uncertainty", kind="short"),
                Column("from", kind="short"), Column("alone", unit), Column("share", "%", "short"),
                Column("total", "%", "short"),
            ),
            "Sources of error",
        )  # fmt: skip
        for share in budget.shares:
            sources.add_row(
                share.name, share.standard, share.origin, _format_size(1e3 * share.alone),
                _format_share(share.first_order, share.first_order_interval),
                _format_share(share.total, share.total_interval),
            )  # fmt: skip
        print_table(console, sources)
        print_text(
            console,
            "alone: 95 % of the errors if all else is exact. share: first-order Sobol index, of the variance. total: "
            f"total Sobol index, with interactions. ±: {100 * COVERAGE:.0f} % interval with these samples, in which "
            "a share may lie below zero or above the total",
            "dim",
        )
        if budget.left_out:
            print_text(console, f"\nNot in the budget: {budget.left_out}")

    def draw(self) -> Figure:
        """The bands over the regions, and the sources' shares."""
        from matplotlib.figure import Figure

        budget, unit = self.budget, f"m{self.budget.unit}"
        figure = Figure(figsize=(13, 5), layout="constrained")
        left, right = figure.subplots(1, 2)
        across = np.arange(len(budget.bands))
        count = len(budget.components)
        for n, name in enumerate(budget.components):
            at = across + (n - 0.5 * (count - 1)) * 0.18
            low, high = (1e3 * np.array([getattr(band, end)[n] for band in budget.bands]) for end in ("low", "high"))
            left.vlines(at, low, high, lw=7, color=f"C{n}", alpha=0.7, label=name)
        _draw_sizes(left, budget.bands, across)
        left.axhline(0.0, color="0.5", lw=0.8)
        left.set_xticks(across, [band.region.replace(" of ", "\nof ") for band in budget.bands], fontsize=8)
        left.set_ylabel(f"error of the delivered wrench [{unit}]")
        left.set_title(f"{100 * COVERAGE:.0f} % bands for {1e3 * budget.asked:g} {unit}", loc="left")
        left.grid(axis="y", alpha=0.3)
        left.legend(frameon=False, fontsize=8)
        scale = 1e3 * budget.jnd * budget.asked
        jnd = left.secondary_yaxis("right", functions=(lambda x: x / scale, lambda x: x * scale))
        jnd.set_ylabel("just-noticeable differences")
        shares = [share for share in budget.shares if share.total >= _LEAST][::-1]
        right.barh(
            [share.name for share in shares], [100 * share.total for share in shares], color="0.8", label="total"
        )
        right.barh(
            [share.name for share in shares],
            [100 * share.first_order for share in shares],
            height=0.45,
            color="C0",
            label="first order",
        )
        for color, name in (("0.5", "total"), ("C1", "first_order")):
            for n, share in enumerate(shares):
                low, high = getattr(share, f"{name}_interval")
                right.plot([100 * low, 100 * high], [n, n], color=color, lw=2 if name == "total" else 1)  # fmt: skip
        right.set_xlabel("share of the variance [%]")
        right.set_title("Sources of error", loc="left")
        right.legend(frameon=False)
        figure.suptitle(self.device.title, x=0.01, ha="left", fontweight="bold")
        return figure

    def _summarize(self) -> str:
        budget = self.budget
        size = budget.bands[-1].size
        return f"<ErrorReport of {budget.device}: {1e3 * size:.3g} m{budget.unit}, {budget.count_jnd(size):.2f} JND>"


def report_errors(
    device: Device | str | Path,
    *,
    asked: float | None = None,
    estimator: str | None = None,
    calibration: Calibration | None = None,
    samples: int = 2000,
    seed: int = 0,
    report: Report | None = None,
) -> ErrorReport:
    """Compute the error budget of the wrench that a device delivers, as `haptorb inspect --errors` does.

    Parameters
    ----------
    device : Device, str or Path
        Device, or its name in the catalogue, or path of its file.
    asked : float, optional
        Magnitude of the commanded wrench [N or N·m]; None: half of the smallest peak.
    estimator : str, optional
        Name of the estimator; None: the choice of the kind of device.
    calibration : Calibration, optional
        Calibration that the controller uses.
    samples : int
        Number of sampled devices in each region of the workspace.
    seed : int
        Seed of the samples.
    report : callable, optional
        Receives the share that is done, 0 to 1.

    Returns
    -------
    ErrorReport
        95 % bands by component and region, and the share of each source, in `budget`.

    Raises
    ------
    InputError
        If the kind of device has no error model.

    Notes
    -----
    Propagation of distributions by Monte Carlo (JCGM 101:2008); shares are first-order Sobol indices.
    """
    known = find_device(device)
    model = error_model(known, asked, estimator, calibration)
    return ErrorReport(known, error_budget(model, samples, seed, report))


def _format_size(size: float) -> str:
    """Two digits; what is nothing but rounding is 0."""
    return f"{size:.2g}" if size >= _ROUNDING else "0"


def _format_share(share: float, interval: tuple[float, float]) -> str:
    """A share of the variance [%] and the longer half of its interval."""
    return f"{100 * share:.1f} ± {100 * max(interval[1] - share, share - interval[0]):.1f}"


def _draw_sizes(place: Any, bands: tuple[WrenchBand, ...], across: Any) -> None:
    """A line for the size of the error, on both sides of zero."""
    for sign in (1, -1):
        sizes = [1e3 * sign * band.size for band in bands]
        place.plot(across, sizes, "k_", ms=40, label="size" if sign > 0 else None)


# --------------------------------------------------------------------------------------------------
# The card of a spherical motor: torque about each axis, condition and heat over the workspace, and who carries it.


_AXES = ("X", "Y", "Z")


@card.register(SphericalMotor)
@final
class MotorCard(Card):
    """Torques are about the stator's axes, each alone, by the table of the exact model."""

    _device: SphericalMotor

    def __init__(self, device: SphericalMotor) -> None:
        self._device = device
        self._capability = motor_capability(device)
        self._endurance = endurance(device)
        self._righting_torques = _righting_torques(device)

    def numbers(self) -> dict[str, Any]:
        """Everything on the card as plain JSON types."""
        device, capability = self._device, self._capability
        tables = device.tables
        return {
            **facts(device),
            "findings": list(device.findings),
            "actuated_dof": 3,
            "sensed_dof": "3 angles by the field sensors; spin only modulo the magnets' period",
            "field_sensors": device.sensors,
            "workspace_tilt_deg": math.degrees(device.workspace_tilt),
            "upright": dict(
                zip(("tilt_rad", "regulator_nm", "weight_nm", "sum_nm"), self._righting_torques.tolist(), strict=True)
            ),
            "tilts_rad": capability.tilts.tolist(),
            "spins_per_tilt": capability.spins,
            "peak_torque_nm": capability.peak.tolist(),
            "continuous_torque_nm": capability.continuous.tolist(),
            "condition": capability.condition.tolist(),
            "weakest_singular_value_nm_per_a": capability.weakest.tolist(),
            "power_w_per_nm2": capability.power.tolist(),
            "channel_shares_of_power": {axis: capability.shares[number].tolist() for number, axis in enumerate(_AXES)},
            "table_error": {"torque": tables.torque_pair.bound, "field": tables.field_pair.bound},
            "endurance": [
                {"share_of_full_current": share, "seconds": seconds if math.isfinite(seconds) else None}
                for share, seconds in self._endurance
            ],
        }

    def show(self, console: Console) -> None:
        """Print it for people."""
        device, capability = self._device, self._capability
        tilt, regulator, weight, rest = self._righting_torques
        more = [
            (
                "workspace",
                f"|ψ|, |λ| up to {math.degrees(device.workspace_tilt):g}°, φ free; rotor {device.rotor.mass:g} kg",
            ),
            ("sensed", f"3 angles by {device.sensors} field sensors; spin only modulo the magnets' period"),
            ("condition", f"{capability.condition.min():.2f} to {capability.condition.max():.2f}"),
            (
                "held upright",
                f"regulator {regulator[-1]:.3f} N·m, weight {-weight[-1]:.3f} N·m at "
                f"{math.degrees(tilt[-1]):g}°; up to {1e3 * np.abs(rest).max():.0f} mN·m remain, which the currents "
                "compensate",
            ),
        ]
        print_card(device, console, more)
        print_build_checks(device, console)
        for finding in device.findings:
            print_text(console, f"overridden: {finding}", "bold red")
        print_text(console)
        torques = TextTable(
            (
                Column("axis", kind="key"), Column("least peak", "N·m"), Column("greatest peak", "N·m"),
                Column("least continuous", "N·m"), Column("worst heat for 0.1 N·m", "W"),
            ),
            "Torque about each axis alone, over the workspace and every spin",
        )  # fmt: skip
        for number, axis in enumerate(_AXES):
            torques.add_row(
                axis,
                f"{capability.peak[..., number].min():.2f}",
                f"{capability.peak[..., number].max():.2f}",
                f"{capability.continuous[..., number].min():.3f}",
                f"{0.01 * capability.power[..., number].max():.2f}",
            )
        print_table(console, torques)
        print_text(console)
        shares = TextTable(
            (Column("channel", kind="key"), Column("coils", kind="text"), *(Column(axis, "%") for axis in _AXES)),
            "Share of the heat per channel, mean over the workspace",
        )
        for channel, name in enumerate(device.coils.names):
            members = np.flatnonzero(device.groups[:, channel])
            wired = " ".join(f"{'+' if device.groups[coil, channel] > 0 else '−'}EM{coil + 1}" for coil in members)
            shares.add_row(name, wired, *(f"{100 * capability.shares[axis, channel]:.0f}" for axis in range(3)))
        print_table(console, shares)
        lasting = ", ".join(f"{100 * share:.0f} % {_duration(seconds)}" for share, seconds in self._endurance)
        room = device.coils.heat.ambient - 273.15
        print_text(console, f"\nendurance of one channel from {room:.0f} °C by share of full current: {lasting}")
        print_text(console, f"assumed: {len(device.assumed)} values (--assumed lists them with their reasons)")

    def quantities(self) -> list[Quantity]:
        """Those of every device, and torque, condition and heat of a motor."""
        device, capability = self._device, self._capability
        peak, lasting, power = capability.peak, capability.continuous, capability.power
        return [
            *common_quantities(device),
            Quantity("workspace, tilt", "°", math.degrees(device.workspace_tilt)),
            Quantity("coils", "", len(device.electromagnets)),
            Quantity("magnets", "", len(device.magnets)),
            Quantity("mass of the rotor", "kg", device.rotor.mass),
            *(Quantity(f"least peak torque about {a}", "N·m", float(peak[..., k].min())) for k, a in enumerate(_AXES)),
            *(Quantity(f"least continuous torque about {a}", "N·m", float(lasting[..., k].min()))
              for k, a in enumerate(_AXES)),
            *(Quantity(f"worst heat for 0.1 N·m about {a}", "W", float(0.01 * power[..., k].max()))
              for k, a in enumerate(_AXES)),
            Quantity("condition, worst", "", float(capability.condition.max())),
        ]  # fmt: skip

    def curves(self) -> list[Curve]:
        """Torque about each axis over the tilt ψ, the other tilt and the spin at their worst; endurance."""
        capability = self._capability
        degrees = np.degrees(capability.tilts)
        return [
            *(
                Curve(f"Torque about {axis}, worst λ and φ", label, "tilt ψ [°]", "torque [N·m]", degrees,
                      torque[..., number].min(axis=1), style)
                for number, axis in enumerate(_AXES)
                for label, torque, style in (
                    ("peak", capability.peak, "-"), ("continuous", capability.continuous, "--")
                )
            ),
            *common_curves(self._device),
        ]  # fmt: skip

    def draw(self) -> Figure:
        """Maps over tilt (worst spin) of torque, condition and heat, the channels' shares, and what holds the rotor
        upright."""
        from matplotlib.figure import Figure

        capability = self._capability
        figure = Figure(figsize=(16, 7), layout="constrained")
        axes = figure.subplots(2, 5)
        degrees = np.degrees(capability.tilts)

        def map_of(place: Any, values: Array, title: str) -> None:
            picture = place.pcolormesh(degrees, degrees, values.T, shading="gouraud", cmap="viridis")
            place.set(xlabel="ψ [°]", ylabel="λ [°]", aspect="equal")
            place.set_title(title, loc="left", fontsize=10)
            figure.colorbar(picture, ax=place, shrink=0.8)

        for number, axis in enumerate(_AXES):
            map_of(axes[0, number], capability.peak[..., number], f"peak torque about {axis} [N·m]")
            map_of(axes[1, number], 0.01 * capability.power[..., number], f"heat for 0.1 N·m, {axis} [W]")
        map_of(axes[0, 3], capability.condition, "condition of K (worst spin)")
        names = self._device.coils.names
        place = axes[1, 3]
        bottom = np.zeros(len(names))
        for number, axis in enumerate(_AXES):
            place.bar(
                np.arange(1, len(names) + 1), 100 * capability.shares[number], bottom=bottom, label=f"about {axis}"
            )
            bottom = bottom + 100 * capability.shares[number]
        place.set_title("share of the heat [%]", loc="left", fontsize=10)
        place.set_xlabel("channel")
        place.legend(frameon=False, fontsize=8)
        place = axes[0, 4]
        for values, name in zip(self._righting_torques[1:], ("regulator", "weight", "both"), strict=True):
            place.plot(np.degrees(self._righting_torques[0]), values, label=name, linewidth=2 if name == "both" else 1)
        place.axhline(0.0, color="0.6", linewidth=0.8)
        place.set(xlabel="tilt [°]")
        place.set_title("restoring torque [N·m]", loc="left", fontsize=10)
        place.legend(frameon=False, fontsize=8)
        axes[1, 4].axis("off")
        figure.suptitle(self._device.title, x=0.01, ha="left", fontweight="bold")
        return figure


def _righting_torques(device: SphericalMotor) -> Array:
    """(4, n): tilt [rad], and what turns the rotor back upright at zero current [N·m]: regulator, weight, both."""
    tilt = np.linspace(0.0, device.workspace_tilt, 46)
    both = np.array([device.passive(rotation_from_euler(0.0, angle, 0.0))[4] for angle in tilt])
    weight = device.rotor.mass * GRAVITY * device.rotor.centre_of_mass * np.sin(tilt)
    return np.stack([tilt, weight - both, -weight, -both])
