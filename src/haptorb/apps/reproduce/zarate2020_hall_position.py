"""What Zárate 2020 left for later: the tool's place from the nine Hall sensors, without a tracker, coils driven.

The accuracy that the sensors' noise and the coils' currents allow over the shell (Cramér and Rao), for the places of
the sensors that the device file assumes and for better ones. The filter of 100 Hz at 1 kHz averages the noise of the
readings to 0.59 of it; errors of the calibration it cannot average, so they are added after it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from haptorb.apps.reproduce.item import Item
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.physics.arrays import Array
from haptorb.runtime.assembly import electromagnet
from haptorb.sensing.position_accuracy import better_sensors, position_accuracy, with_sensors

__all__ = ["filtered_share", "items", "position_map"]

_CALIBRATED = 1e-3  #: standard deviation of the moment map's entries after `haptorb calibrate`
_NOISES = (0.01e-3, 0.02e-3, 0.05e-3)


def filtered_share(bandwidth: float = 100.0, rate: float = 1000.0) -> float:
    """Standard deviation that white noise keeps in the α–β filter of `HallTracker`.

    From the variance of a critically damped α–β filter: (2α² + 2β − 3αβ)/(α (4 − 2α − β)).

    >>> round(filtered_share(), 2)
    0.53
    """
    tau = 2.482 / (2 * math.pi * bandwidth)
    theta = math.exp(-1 / (rate * tau))
    alpha, beta = 1 - theta**2, (1 - theta) ** 2
    return math.sqrt((2 * alpha**2 + 2 * beta - 3 * alpha * beta) / (alpha * (4 - 2 * alpha - beta)))


def position_map(
    device: SphericalElectromagnet, distances: Array, angles: Array, *, noise: float, amperes: float
) -> Array:
    """(distances, angles, 2) rms errors of place [m] and axis [rad] after the filter, mean over eight azimuths."""
    turns = np.arange(8) * np.pi / 4 + 0.1
    directions = np.stack(
        [np.sin(angles)[:, None] * np.cos(turns), np.sin(angles)[:, None] * np.sin(turns),
         np.broadcast_to(np.cos(angles)[:, None], (len(angles), len(turns)))], axis=-1,
    )  # fmt: skip
    places = distances[:, None, None, None] * directions
    flat, currents = places.reshape(-1, 3), np.full(device.channels, amperes)
    random = position_accuracy(device, flat, currents=currents, noise=noise)
    whole = position_accuracy(device, flat, currents=currents, noise=noise, calibration=_CALIBRATED)
    lasting = np.maximum(whole**2 - random**2, 0.0) if amperes else 0.0
    variance = filtered_share() ** 2 * random**2 + lasting
    squares = np.stack([variance[:, :3].sum(axis=1), variance[:, 3:].sum(axis=1)], axis=-1)
    mean: Array = np.sqrt(squares.reshape(len(distances), len(angles), len(turns), 2).mean(axis=2))
    return mean


def items(report: Callable[[float], None]) -> tuple[tuple[Item, ...], Callable[[Path], Path]]:
    """Accuracy at both placements, and what draws the maps."""
    from haptorb.devices.loader import load

    device = electromagnet(load("omni"))
    placements = {"assumed places": device, "better places": with_sensors(device, better_sensors(device))}
    distances = device.contact_distance + np.linspace(0, device.shell_thickness, 9)
    angles = np.linspace(0.0, device.workspace_half_angle, 9)
    weight = np.sin(angles) / np.sin(angles).sum()
    maps: dict[tuple[str, float, float], Array] = {}
    for n, (name, placed) in enumerate(placements.items()):
        for noise in _NOISES:
            for amperes in (0.0, 20.0):
                maps[name, noise, amperes] = position_map(placed, distances, angles, noise=noise, amperes=amperes)
        report((n + 1) / 2)
    found = []
    for name in placements:
        for amperes in (0.0, 20.0):
            squares = (maps[name, 0.02e-3, amperes] ** 2 * weight[:, None]).sum(axis=1).mean(axis=0)
            place, turn = np.sqrt(squares)
            where = f"{name}, {'all coils at 20 A' if amperes else 'currents off'}, 0.02 mT, 100 Hz"
            key = f"hall-{name.split()[0]}-{amperes:.0f}"
            found += [
                Item(f"{key}-place", "zarate2020", "§VI", f"rms error of the place over the shell, {where}", None,
                     1e3 * float(place), "mm", None),
                Item(f"{key}-axis", "zarate2020", "§VI", f"rms error of the axis over the shell, {where}", None,
                     math.degrees(float(turn)), "°", None),
            ]  # fmt: skip
    return tuple(found), lambda path: _drawn(maps, list(placements), distances, angles, path)


def _drawn(
    maps: dict[tuple[str, float, float], Array], names: list[str], distances: Array, angles: Array, path: Path
) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 10), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(4, len(_NOISES), sharex=True, sharey=True)
    levels = [0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0]
    for r, (name, amperes) in enumerate((name, amperes) for name in names for amperes in (0.0, 20.0)):
        for panel, noise in zip(panels[r], _NOISES, strict=True):
            millimetres = 1e3 * maps[name, noise, amperes][:, :, 0]
            filled = panel.contourf(np.degrees(angles), 1e3 * distances, millimetres, levels, cmap="viridis_r",
                                    extend="both")  # fmt: skip
            line = panel.contour(np.degrees(angles), 1e3 * distances, millimetres, [0.5], colors="k", linewidths=1.5)
            panel.clabel(line, fmt="0.5 mm")
            current = "all coils 20 A, map known to 0.1 %" if amperes else "currents off"
            panel.set_title(f"{name}, {1e3 * noise:g} mT, {current}", fontsize=9, loc="left")
        panels[r][0].set_ylabel("magnet [mm]")
    for panel in panels[-1]:
        panel.set_xlabel("angle from the summit [°]")
    figure.colorbar(filled, ax=panels, label="rms error of the place after the 100 Hz filter [mm]")
    figure.suptitle("Tool found by nine Hall sensors: distance to the tool limits it, then noise, then calibration")
    figure.savefig(path, dpi=110)
    return path
