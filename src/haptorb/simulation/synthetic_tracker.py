"""Synthetic tracker, and a synthetic user who touches a dome with the tool: test data for frame registration.

The user moves over the dome on a spiral with the tool tilted to all sides, lifts it occasionally, tilts it in every
mark, and rolls it in a bore. The tracker observes a rigid body on the tool, in its own frame, with noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

import numpy as np
from scipy.spatial.transform import Rotation

from haptorb.arrays import Array
from haptorb.devices.base import rotation_to_axis
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import InputError
from haptorb.estimation.frame_registration import Touches, TouchSession

__all__ = ["SimulatedPerson", "SyntheticTracker"]

_TILT = np.deg2rad(32.0)  #: of the tool from the dome's normal, in the marks too [rad]
_LIFTED_SHARE = 0.05  #: share of the path over the dome on which the tip is lifted
_MAX_LIFT_M = 6e-3  #: maximum lift [m]
_BORE_PLAY_RAD = np.deg2rad(0.2)  #: play of the tool in its bore [rad]


@final
@dataclass(frozen=True)
class SyntheticTracker:
    """Tracker with a frame, a rigid body and noise.

    R, t    (3, 3), (3,) [m] tracker into stator: x_S = R x_T + t
    tip     (3,) in the body [m]; axis (3,) unit vector from the tip towards the magnet
    noise   of each coordinate [m]; turning, of each axis [rad]
    """

    R: Array
    t: Array
    tip: Array
    axis: Array
    noise: float = 1e-4
    turning: float = float(np.deg2rad(0.05))

    @classmethod
    def draw(cls, seed: int, noise: float = 1e-4, turning: float = float(np.deg2rad(0.05))) -> SyntheticTracker:
        """Random frame within 2 m, and a body up to 15 cm from the tip in a random orientation."""
        rng = np.random.default_rng(seed)
        frame, body = Rotation.random(2, random_state=rng).as_matrix()
        along, aside = rng.uniform(0.03, 0.14), rng.uniform(-0.03, 0.03, 2)
        tip = body @ np.array([*aside, -along])
        return cls(frame, rng.uniform(-1.2, 1.2, 3), tip, body[:, 2], noise, turning)

    def observe(self, tips: Array, turns: Array, rng: np.random.Generator) -> Touches:
        """Observed body poses with the tip at tips (n, 3) [m] and tool rotations turns (n, 3, 3) to the stator
        frame."""
        body = turns @ rotation_to_axis(self.axis).T  # the tool's z is the body's axis
        places = (tips - body @ self.tip - self.t) @ self.R
        places += rng.normal(0.0, self.noise, places.shape)
        shaken = Rotation.from_rotvec(rng.normal(0.0, self.turning, (len(tips), 3))).as_matrix()
        return Touches(places, Rotation.from_matrix(shaken @ (self.R.T @ body)).as_quat())


@final
@dataclass
class SimulatedPerson:
    """Simulated user with the tool of `device` under `tracker`; each motion starts where the previous one ended."""

    device: SphericalElectromagnet
    tracker: SyntheticTracker
    seed: int = 0
    reach: float = 1.0  #: covered share of the workspace's half angle
    tilt: float = float(_TILT)  #: of the tool [rad]
    turn: float = 1.1  #: rotation of the tool while it is rolled [turns]
    _rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)

    def dome(self, n: int) -> Touches:
        """n poses with the tip on the dome, on a spiral from the summit outwards."""
        s = (np.arange(n) + 0.5) / n
        polar = self.reach * self.device.workspace_half_angle * np.sqrt(s)
        azimuth = 2 * np.pi * 7 * np.sqrt(s) + self._rng.uniform(0, 2 * np.pi)
        normals = np.column_stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
        up = np.maximum(np.sin(2 * np.pi * 5 * s) - np.cos(np.pi * _LIFTED_SHARE), 0.0)
        up *= _MAX_LIFT_M / max(float(up.max()), 1e-12)
        return self._hold((self.device.dome_radius + up)[:, None] * normals, normals, s)

    def mark(self, name: str, n: int) -> Touches:
        """n poses with the tip in the mark `name`, tilted to all sides. Raises InputError for an unknown mark."""
        marks = self.device.marks
        if marks is None or name not in marks.names:
            raise InputError(f"device '{self.device.name}' has no mark '{name}'")
        place = marks.positions[marks.names.index(name)]
        normals = np.tile(place / np.linalg.norm(place), (n, 1))
        return self._hold(np.tile(place, (n, 1)), normals, (np.arange(n) + 0.5) / n)

    def roll(self, n: int) -> Touches:
        """n poses of the tool upright in a bore beside the device, rotated about its axis."""
        s = np.arange(n) / max(n - 1, 1)
        sway = _BORE_PLAY_RAD * np.column_stack([np.cos(9 * s), np.sin(7 * s), np.zeros(n)])
        spin = np.outer(2 * np.pi * self.turn * s, (0.0, 0.0, 1.0))
        turns = (Rotation.from_rotvec(sway) * Rotation.from_rotvec(spin)).as_matrix()
        return self.tracker.observe(np.tile([0.12, 0.05, -0.03], (n, 1)), turns, self._rng)

    def session(self, dome: int = 240, mark: int = 60, roll: int = 60) -> TouchSession:
        """Simulate all steps of a registration, with that many poses each. InputError for a device without marks."""
        if self.device.marks is None:
            raise InputError(f"device '{self.device.name}' has no marks")
        stands = {name: self.mark(name, mark) for name in self.device.marks.names}
        return TouchSession(self.dome(dome), stands, self.roll(roll))

    def _hold(self, tips: Array, normals: Array, s: Array) -> Touches:
        """Poses tilted about the normals, to all sides in turn, with the small roll of a hand."""
        turned = 2 * np.pi * 11 * s + self._rng.uniform(0, 2 * np.pi)
        much = self.tilt * (0.55 + 0.45 * np.cos(2 * np.pi * 4 * s))
        upright = np.stack([rotation_to_axis(normal) for normal in normals])
        lean = np.column_stack([much * np.cos(turned), much * np.sin(turned), np.zeros(len(s))])
        rolled = np.outer(0.6 * np.sin(2 * np.pi * 3 * s), (0.0, 0.0, 1.0))
        turns = upright @ (Rotation.from_rotvec(lean) * Rotation.from_rotvec(rolled)).as_matrix()
        return self.tracker.observe(tips, turns, self._rng)
