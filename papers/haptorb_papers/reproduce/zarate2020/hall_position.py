"""Beyond Zárate 2020, which uses a tracker: tool position from the nine Hall sensors alone, coils driven.

Twice, and independently: the accuracy that the sensors' noise and the coils' currents allow over the shell (Cramér and
Rao), and what the tracker reaches on the simulated device. For the places of the sensors that the device file assumes,
for the four diagonals below the centre instead of those between x and y, and for places that the paper does not have.
The filter of 100 Hz at 1 kHz averages the noise of the readings to 0.55 of it; errors of the calibration it cannot
average, so they are added after it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from haptorb.arrays import Array
from haptorb.devices.api import electromagnet
from haptorb.devices.base import rotation_to_axis
from haptorb.devices.electromagnet import Hand, SphericalElectromagnet
from haptorb.estimation.hall_pose_fit import better_sensors, position_accuracy, with_sensors
from haptorb.estimation.hall_tracker import HallTracker, noise_share
from haptorb.estimation.sensor_calibration import without_errors
from haptorb.simulation.electromagnet import SimulatedElectromagnet
from haptorb_papers.reproduce.item import Item

__all__ = ["bound", "clamp_tool", "items", "placements", "position_map", "shell_places", "try_hall_tracker"]


# --------------------------------------------------------------------------------------------------
# The tool's place from the Hall sensors, tried: the simulated device with its noise, read at 1 kHz by the tracker.
#
# Nothing here comes from the formula of `hall_pose_fit.position_accuracy`: the field is the simulation's, its readings
# have noise and steps, the coils' currents are measured as a driver measures them, the tracker finds the tool from
# nothing.


_SETTLED = 40  #: ticks after which currents and filter are what they stay


def shell_places(device: SphericalElectromagnet, count: int = 4) -> tuple[Array, Array]:
    """Places (n, 3) [m] all over the shell, and the share of its directions and distances that each stands for (n,).

    >>> from haptorb.devices.loader import load
    >>> places, weights = shell_places(load("omni"))
    >>> places.shape, round(float(weights.sum()), 9)
    ((64, 3), 1.0)
    """
    middle = (np.arange(count) + 0.5) / count
    distance = device.contact_distance + device.shell_thickness * middle
    angle = device.workspace_half_angle * middle
    turn = 2 * np.pi * (np.arange(count) + 0.25) / count
    d, a, t = (one.ravel() for one in np.meshgrid(distance, angle, turn, indexing="ij"))
    places: Array = d[:, None] * np.column_stack([np.sin(a) * np.cos(t), np.sin(a) * np.sin(t), np.cos(a)])
    weights: Array = np.sin(a) / np.sin(a).sum()
    return places, weights


def try_hall_tracker(
    device: SphericalElectromagnet, places: Array, duty: float, *, calibration: float = 0.0, ticks: int = 120,
    bandwidth: float = 100.0, seed: int = 0,
) -> Array:  # fmt: skip
    """(n, 3) rms errors of place [m] and axis [rad] of a radial tool clamped at each of `places` (n, 3) [m], and the
    share of the ticks in which it was found [1]; the errors are those of the ticks in which it was.

    duty [1] on every coil; calibration: standard deviation of each entry of the moment map that the tracker uses,
    as a share of its column, drawn separately for each position.
    """
    rng, still = np.random.default_rng(seed), clamp_tool(device)
    out = np.empty((len(places), 3))
    duties = np.full(device.channels, duty)
    world = SimulatedElectromagnet(still, seed, specimen=0)
    for row, p in zip(out, places, strict=True):
        world.reset(int(rng.integers(2**31)))  # cold coils: warm ones take less current
        q = Rotation.from_matrix(rotation_to_axis(p)).as_quat()
        world.place(p, q)
        scale = calibration * np.linalg.norm(device.moment_per_current, axis=0)
        moments = device.moment_per_current + scale * rng.standard_normal(device.moment_per_current.shape)
        tracker = HallTracker(replace(device, moment_per_current=moments), bandwidth=bandwidth)
        squares: list[tuple[float, float]] = []
        for tick in range(ticks):
            world.advance(1e-3, duties, p, q)
            found = tracker.update(world.sample(1e-3 * tick, 1e-3 * tick, True))
            if tick >= _SETTLED:
                true = world.state()
                turned = float(np.arccos(np.clip(found.state.axis @ true.axis, -1.0, 1.0)))
                far = found.state.p - true.p
                if found.valid:
                    squares.append((float(far @ far), turned**2))
        row[:2] = np.sqrt(np.mean(squares, axis=0)) if squares else np.nan
        row[2] = len(squares) / (ticks - _SETTLED)
    return out


def clamp_tool(device: SphericalElectromagnet) -> SphericalElectromagnet:
    """`device` with its tool in a vice instead of a hand: full currents would push it off its place."""
    hand = device.hand
    vice = Hand(1e3, hand.damping, hand.stiffness, hand.turn_damping, hand.turn_stiffness)
    return replace(device, hand=vice, tool=replace(device.tool, inertia=np.full(3, 10.0)))


_CALIBRATED = 1e-3  #: standard deviation of the moment map's entries after `haptorb calibrate`
_NOISES = (0.01e-3, 0.02e-3, 0.05e-3)
_WHERE = "not in the paper"
_FULL = 20.0  #: current of every coil at full duty [A]


def placements(device: SphericalElectromagnet) -> dict[str, SphericalElectromagnet]:
    """`device` with its own places of the sensors, with its diagonals below the centre, and with two rings.

    >>> from haptorb.devices.loader import load
    >>> list(placements(electromagnet(load("omni"))))
    ['assumed places', 'diagonals below', 'two rings']
    """
    below = device.hall.positions.copy()
    diagonal = np.count_nonzero(np.abs(below) > 1e-6, axis=1) > 1
    below[diagonal] *= math.sqrt(2 / 3)
    below[diagonal, 2] = -np.abs(below[diagonal, 0])
    return {
        "assumed places": device,
        "diagonals below": with_sensors(device, below),
        "two rings": with_sensors(device, better_sensors(device)),
    }


def bound(device: SphericalElectromagnet, places: Array, amperes: float, noise: float = 0.02e-3) -> Array:
    """(n, 2) least possible rms errors of place [m] and axis [rad] after the filter, radial tool at `places` (n, 3)."""
    currents = np.full(device.channels, amperes)
    random = position_accuracy(device, places, currents=currents, noise=noise)
    whole = position_accuracy(device, places, currents=currents, noise=noise, calibration=_CALIBRATED)
    lasting = np.maximum(whole**2 - random**2, 0.0) if amperes else 0.0
    variance = noise_share() ** 2 * random**2 + lasting
    out: Array = np.sqrt(np.stack([variance[:, :3].sum(axis=1), variance[:, 3:].sum(axis=1)], axis=-1))
    return out


def position_map(
    device: SphericalElectromagnet, distances: Array, angles: Array, *, noise: float, amperes: float
) -> Array:
    """(distances, angles, 2) rms errors of place [m] and axis [rad] after the filter, mean over four azimuths."""
    turns = np.arange(4) * np.pi / 2 + 0.3  # the placements repeat, nearly, with a quarter turn
    directions = np.stack(
        [np.sin(angles)[:, None] * np.cos(turns), np.sin(angles)[:, None] * np.sin(turns),
         np.broadcast_to(np.cos(angles)[:, None], (len(angles), len(turns)))], axis=-1,
    )  # fmt: skip
    places = distances[:, None, None, None] * directions
    squares = bound(device, places.reshape(-1, 3), amperes, noise) ** 2
    mean: Array = np.sqrt(squares.reshape(len(distances), len(angles), len(turns), 2).mean(axis=2))
    return mean


def items(report: Callable[[float], None]) -> tuple[tuple[Item, ...], Callable[[Path], Path]]:
    """Accuracy at every placement, by formula and tried, and what draws the maps."""
    from haptorb.devices.loader import load

    device = without_errors(electromagnet(load("omni")))
    cases = [(name, placed, amperes) for name, placed in placements(device).items() for amperes in (0.0, _FULL)]
    distances = device.contact_distance + np.linspace(0, device.shell_thickness, 7)
    angles = np.linspace(0.0, device.workspace_half_angle, 8)
    maps: dict[tuple[str, float, float], Array] = {}
    places, weights = shell_places(device)
    found = []
    for n, (name, placed, amperes) in enumerate(cases):
        for noise in _NOISES:
            maps[name, noise, amperes] = position_map(placed, distances, angles, noise=noise, amperes=amperes)
        best = np.sqrt(weights @ bound(placed, places, amperes) ** 2)
        reached = try_hall_tracker(placed, places, amperes / _FULL, calibration=_CALIBRATED if amperes else 0.0)
        rms = np.sqrt(weights @ reached[:, :2] ** 2)
        where = f"{name}, {'all coils at 20 A' if amperes else 'currents off'}, 0.02 mT, 100 Hz"
        key = f"hall-{name.replace(' ', '-')}-{amperes:.0f}"
        for kind, unit, part, scale in (("place", "mm", 0, 1e3), ("axis", "°", 1, math.degrees(1.0))):
            for how, value in (("tried", rms[part]), ("least possible", best[part]),
                               ("simulated, at the worst position", reached[:, part].max())):  # fmt: skip
                what = f"rms error of the {kind} over the shell, {how}: {where}"
                id = f"{key}-{kind}-{how.replace(',', '').replace(' ', '-')}"
                found.append(Item(id, "zarate2020", _WHERE, what, None, scale * float(value), unit, None))
        found.append(Item(f"{key}-found", "zarate2020", _WHERE, f"share of ticks with a valid pose: {where}",
                          None, float(weights @ reached[:, 2]), "1", None))  # fmt: skip
        report((n + 1) / len(cases))
    return tuple(found), lambda path: _draw_figure(maps, list(placements(device)), distances, angles, path)


def _draw_figure(
    maps: dict[tuple[str, float, float], Array], names: list[str], distances: Array, angles: Array, path: Path
) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 14), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2 * len(names), len(_NOISES), sharex=True, sharey=True)
    levels = [0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0]
    for r, (name, amperes) in enumerate((name, amperes) for name in names for amperes in (0.0, _FULL)):
        for panel, noise in zip(panels[r], _NOISES, strict=True):
            millimetres = 1e3 * maps[name, noise, amperes][:, :, 0]
            filled = panel.contourf(np.degrees(angles), 1e3 * distances, millimetres, levels, cmap="viridis_r",
                                    extend="both")  # fmt: skip
            line = panel.contour(np.degrees(angles), 1e3 * distances, millimetres, [0.5], colors="k", linewidths=1.5)
            panel.clabel(line, fmt="0.5 mm")
            current = "20 A, calibrated to 0.1 %" if amperes else "currents off"
            panel.set_title(f"{name}, {1e3 * noise:g} mT, {current}", fontsize=9, loc="left")
        panels[r][0].set_ylabel("magnet [mm]")
    for panel in panels[-1]:
        panel.set_xlabel("angle from the summit [°]")
    figure.colorbar(filled, ax=panels, label="rms position error after the 100 Hz filter [mm]")
    figure.suptitle("Tool position by nine Hall sensors: limited by distance to the tool, then noise, then calibration")
    figure.savefig(path, dpi=110)
    return path
