"""The tool's place from the Hall sensors, tried: the simulated device with its noise, read at 1 kHz by the tracker.

Nothing here comes from the formula of `sensing.position_accuracy`: the field is the simulation's, its readings have
noise and steps, the coils' currents are measured as a driver measures them, the tracker finds the tool from nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from haptorb.arrays import Array
from haptorb.devices.base import rotation_to_axis
from haptorb.devices.electromagnet import Hand, SphericalElectromagnet
from haptorb.estimation.hall_tracker import HallTracker
from haptorb.simulation.electromagnet import SimulatedElectromagnet

__all__ = ["clamp_tool", "shell_places", "try_hall_tracker"]

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
    for row, p in zip(out, places, strict=True):
        world = SimulatedElectromagnet(still, int(rng.integers(2**31)))
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
