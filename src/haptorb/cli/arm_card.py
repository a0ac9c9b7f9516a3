"""Capability card of a haptic arm: force, apparent mass, sensing, and the stiffness of a wall that it renders."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, final

import numpy as np
from rich.console import Console

from haptorb.analysis.stability import HandGrip, SampledLoop
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
from haptorb.devices.arm import Arm
from haptorb.devices.base import endurance
from haptorb.terminal import Column, TextTable, print_table, print_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ArmCard"]


@final
class ArmCard(Card):
    """Card of an arm: forces hold in the whole workspace; stiffness limits hold for a loop of 1 kHz."""

    _device: Arm

    def __init__(self, device: Arm) -> None:
        self._device = device
        coils = device.coils
        self._loop = SampledLoop.of(1000.0, time_constant=float(np.max(coils.inductance / coils.resistance)))
        hand = device.hand
        self._grip = HandGrip(device.effector.mass + hand.mass, device.effector.viscous + hand.damping, hand.stiffness)
        self._endurance = endurance(device)

    def numbers(self) -> dict[str, Any]:
        """Return everything on the card as plain JSON types."""
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
        """Return the largest passive stiffness with the hand's damping: 2b/T (Colgate and Schenkel 1997) [N/m]."""
        return self._loop.passive_bound(self._grip.damping)

    @property
    def _stable(self) -> float:
        """Return the largest stable stiffness with the hand of the device file, motor lag included [N/m]."""
        return self._loop.largest(self._grip)

    def show(self, console: Console) -> None:
        """Print the card on `console`."""
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
        """Return the card's quantities for a comparison with other devices, in order."""
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
        """Return the card's curves for a comparison with other devices."""
        return common_curves(self._device)

    def draw(self) -> Figure:
        """Return the card as a figure."""
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
