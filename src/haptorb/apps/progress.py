"""A bar for what takes longer than a moment: the pair tables of a motor, built once per machine and shape."""

from __future__ import annotations

from rich.console import Console

from haptorb.devices.device import Device

__all__ = ["build_tables"]


def build_tables(device: Device) -> None:
    """Build the tables of `device` if it has any, with a bar on standard error while the exact level is asked.

    Nothing is drawn where the tables come from the cache, or where standard error is not a terminal.
    """
    from haptorb.devices.spherical_motor import SphericalMotor

    if not isinstance(device, SphericalMotor) or "tables" in vars(device):
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from haptorb.devices.motor_tables import motor_tables

    columns = (TextColumn("exact torque and field"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("tables", total=None, visible=False)

        def report(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total, visible=True)

        vars(device)["tables"] = motor_tables(device, report)
