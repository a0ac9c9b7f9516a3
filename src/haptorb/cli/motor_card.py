"""Capability card of a spherical motor: torque about each axis, condition and heat over the workspace."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, final

import numpy as np
from rich.console import Console

from haptorb.arrays import Array
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
from haptorb.control.capability import motor_capability
from haptorb.devices.base import endurance
from haptorb.devices.motor import GRAVITY, SphericalMotor
from haptorb.rotations import rotation_from_euler
from haptorb.terminal import Column, TextTable, print_table, print_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["MotorCard"]


_AXES = ("X", "Y", "Z")


@final
class MotorCard(Card):
    """Card of a motor: torques about the stator's axes, each alone, interpolated from the exact model."""

    _device: SphericalMotor

    def __init__(self, device: SphericalMotor) -> None:
        self._device = device
        self._capability = motor_capability(device)
        self._endurance = endurance(device)
        self._righting_torques = _righting_torques(device)

    def numbers(self) -> dict[str, Any]:
        """Return everything on the card as plain JSON types."""
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
        """Print the card on `console`."""
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
        """Return the common quantities, and torque, condition and heat of a motor."""
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
        """Return torque about each axis over the tilt ψ, worst over the other tilt and the spin; endurance."""
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
        """Draw maps over tilt (worst spin) of torque, condition and heat, the channels' shares, and the passive
        restoring torque."""
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
    """Return tilt [rad] and restoring torques at zero current [N·m] (4, n): regulator, weight, both."""
    tilt = np.linspace(0.0, device.workspace_tilt, 46)
    both = np.array([device.passive(rotation_from_euler(0.0, angle, 0.0))[4] for angle in tilt])
    weight = device.rotor.mass * GRAVITY * device.rotor.centre_of_mass * np.sin(tilt)
    return np.stack([tilt, weight - both, -weight, -both])
