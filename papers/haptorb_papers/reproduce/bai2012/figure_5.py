"""Bai 2012, Fig. 5 and section 3: the design loop, and the weight-compensating regulator."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from haptorb.arrays import Array
from haptorb.control.allocation import MinimumPowerAllocator
from haptorb.devices.api import motor
from haptorb.devices.base import State
from haptorb.devices.motor import SphericalMotor
from haptorb.rotations import rotation_from_euler
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Drawing, Report

__all__ = ["items"]

_AT = Citation("bai2012", "fig5", "Fig. 5(b), §3")


def items(report: Report) -> tuple[tuple[Item, ...], Drawing]:
    """Signs of the torque on a leaning rotor with and without regulator, and its compensation by the currents."""
    device = motor("pmsm")
    bare = replace(device, regulator=None)
    tilts = np.linspace(0.0, device.workspace_tilt, 30)
    alone, held = _righting_torque(bare, tilts), _righting_torque(device, tilts)
    report(0.5)
    R = rotation_from_euler(0.2, -0.1, 0.7)
    wanted = np.array([0, 0, 0, 0.05, 0.02, -0.03])
    state = State.from_rotation(R)
    known = device.wrench_map(state, "table")
    given = MinimumPowerAllocator(device.coils.current_limit, compensate_passive=True).allocate(known, wanted)
    left = known.matrix @ given.currents + known.passive - wanted
    report(1.0)
    assumed = "the paper gives no sizes of rotor and rings: assumed so that this is true"
    return (
        _AT.assume("topples",
                 "sign of the torque on a leaning rotor, no currents and no regulator ('inverted pendulum')",
                 -1.0, np.sign(alone[1:]).max(), "1", 0.0, assumed),
        _AT.assume("holds", "the same with the regulator, to 20° of tilt ('supports the rotor against gravity')", 1.0,
                 np.sign(held[1:][tilts[1:] <= np.radians(20.0)]).min(), "1", 0.0, assumed),
        _AT.compare("compensated", "remaining torque when the regulator is compensated in the currents, relative", 0.0,
                 np.linalg.norm(left[3:]) / np.linalg.norm(wanted[3:]), "1", 1e-9, "the allocator's own equation"),
        _AT.note("weight", "torque of the weight at the edge of the workspace", -alone[-1], "N·m", assumed),
        _AT.note("saved", "share of it that the regulator carries", 1 - held[-1] / alone[-1], "1"),
        _AT.note("saved-upright", "the same at 5° of tilt", 1 - np.interp(0.0873, tilts, held)
                 / np.interp(0.0873, tilts, alone), "1", "more than the whole weight: the remainder turns the rotor "
                                                         "upright"),
        _AT.exempt("loop", "the loop of design, feeling and choosing", "a procedure, not a number; `haptorb feel` "
                      "runs it: candidates are rendered, rated, and the choice is recorded", "Fig. 5(a)"),
        _AT.exempt("photo", "the prototype", "a photograph"),
    ), lambda path: _draw_figure(tilts, alone, held, path)  # fmt: skip


def _righting_torque(device: SphericalMotor, tilts: Array) -> Array:
    """(n,) [N·m] at zero current, positive where it turns the rotor back upright."""
    return np.array([-device.passive(rotation_from_euler(tilt, 0.0, 0.0))[3] for tilt in tilts])


def _draw_figure(tilts: Array, alone: Array, held: Array, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4), layout="constrained")
    FigureCanvasAgg(figure)
    panel = figure.subplots()
    degrees = np.degrees(tilts)
    panel.plot(degrees, alone, "C3", label="weight alone")
    panel.plot(degrees, held - alone, "C0", label="regulator alone")
    panel.plot(degrees, held, "k", lw=2, label="both")
    panel.axhline(0, color="k", lw=0.6)
    panel.set(xlabel="tilt [°]", ylabel="righting torque [N·m]", xlim=(0, degrees[-1]))
    panel.legend(frameon=False)
    panel.grid(alpha=0.3)
    panel.set_title("The rotor at zero current (sizes of rings and rotor assumed)", loc="left", fontsize=10)
    figure.savefig(path, dpi=120)
    return path
