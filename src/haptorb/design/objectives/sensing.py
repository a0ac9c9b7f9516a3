"""How well the field sensors tell where tool or rotor is, by Cramér and Rao's bound, and whether they are in the way.

The bounds are of one sample with its noise, currents off; lasting errors of the sensors are left out, as a calibration
takes most of them away.
"""

from __future__ import annotations

import numpy as np

from haptorb.design.candidate import DesignCandidate
from haptorb.design.objectives.motor_torque import motor_of
from haptorb.design.objectives.orientations import spread_angles
from haptorb.design.objectives.registry import describe, option
from haptorb.design.objectives.tool_force import electromagnet_of
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.state import rotation_to_axis
from haptorb.devices.tables import table_kernels
from haptorb.devices.tables.table_cache import load_field_table
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.numerics.directions import cap_directions
from haptorb.numerics.rotations import rotation_from_euler
from haptorb.physics.sources.ring import RingMagnet
from haptorb.sensing.tool.position_accuracy import position_accuracy
from haptorb.sensing.tool.tool_field import coil_field

__all__ = ["QUANTITIES", "pen_distance", "shell_places"]

_MOTOR, _ELECTROMAGNET = "spherical-motor", "spherical-electromagnet"
_LAYERS, _DIRECTIONS = 4, 16
_ORIENTATIONS = 100
_PEN = 7e-3  #: radius of the pen around the tool's magnet [m]
_LEAN = np.radians(15.0)  #: of the pen against the radius, at most
_CHIP = 3e-3  #: from a sensor's centre to the farthest edge of its chip, with air [m]


def shell_places(device: SphericalElectromagnet) -> Array:
    """(64, 3) [m] places of the tool's magnet that fill the shell: four layers, 16 directions each."""
    share = (np.arange(_LAYERS) + 0.5) / _LAYERS
    distances = device.contact_distance + device.shell_thickness * share
    directions = cap_directions(device.workspace_half_angle, _DIRECTIONS)
    places: Array = (distances[:, None, None] * directions).reshape(-1, 3)
    return places


def _position(candidate: DesignCandidate) -> float:
    device = electromagnet_of(candidate)
    if device.sensors < 2:
        raise InputError("locating a tool needs at least two field sensors: add them to [hall]")
    deviations = position_accuracy(device, shell_places(device))[:, :3]
    return float(np.sqrt((deviations**2).sum(axis=1).mean()))


def _orientation(candidate: DesignCandidate) -> float:
    motor = motor_of(candidate)
    table = load_field_table(motor.magnet, motor.magnets.distance, motor.sensor_layout.distance, precision=1e-5)
    angles = spread_angles(motor.workspace_tilt, int(option(candidate, "orientations", _ORIENTATIONS)))
    R = np.ascontiguousarray(rotation_from_euler(angles[:, 0], angles[:, 1], angles[:, 2]))
    field, slope = np.empty((len(R), motor.sensors, 3)), np.empty((len(R), motor.sensors, 3, 3))
    table_kernels.sensor_field_gradient(
        table.cells, table.scale, motor.magnets.directions, motor.polarity, motor.sensor_layout.directions, R, field,
        slope,
    )  # fmt: skip
    J = slope.reshape(len(R), -1, 3)
    variance = motor.hall.noise**2 + motor.hall.step**2 / 12
    spread = variance * np.trace(np.linalg.inv(J.transpose(0, 2, 1) @ J), axis1=1, axis2=2)
    return float(np.sqrt(spread.mean()))


def pen_distance(device: SphericalElectromagnet, points: Array, lean: float) -> Array:
    """(k,) least distance [m] of `points` (k, 3) [m] from the axis of a pen whose tip is on the dome, anywhere within
    the workspace, and which leans up to `lean` [rad] against the radius, to any side; the pen is long."""
    points = np.asarray(points)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    turns, angles = np.radians(np.arange(-60.0, 61.0, 5.0)), device.workspace_half_angle * np.array([0.6, 0.8, 1.0])
    sides, leans = 2 * np.pi * np.arange(16) / 16, lean * np.array([0.0, 0.5, 1.0])
    turn, angle, side, tilt = (one.ravel() for one in np.meshgrid(turns, angles, sides, leans, indexing="ij"))
    out = np.empty(len(points))
    for k, (point, middle) in enumerate(zip(points, azimuth, strict=True)):
        c, s = np.cos(middle + turn), np.sin(middle + turn)
        zero = np.zeros_like(c)
        radial = np.stack([np.sin(angle) * c, np.sin(angle) * s, np.cos(angle)], axis=1)
        south = np.stack([np.cos(angle) * c, np.cos(angle) * s, -np.sin(angle)], axis=1)
        east = np.stack([-s, c, zero], axis=1)
        away = np.cos(side)[:, None] * south + np.sin(side)[:, None] * east
        axis = np.cos(tilt)[:, None] * radial + np.sin(tilt)[:, None] * away
        from_tip = point - device.dome_radius * radial
        along = np.maximum((from_tip * axis).sum(axis=1), 0.0)
        out[k] = np.linalg.norm(from_tip - along[:, None] * axis, axis=1).min()
    return out


def _room(candidate: DesignCandidate) -> float:
    device = electromagnet_of(candidate)
    at = device.hall.positions
    chip = option(candidate, "chip", _CHIP)
    dome = np.linalg.norm(at, axis=1) - device.dome_radius
    pen = pen_distance(device, at, option(candidate, "lean", _LEAN)) - option(candidate, "pen", _PEN)
    apart = np.linalg.norm(at[:, None] - at[None], axis=2) + np.diag(np.full(len(at), np.inf))
    return float(min(dome.min() - chip, pen.min() - chip, apart.min() - 2 * chip))


def _field(candidate: DesignCandidate) -> float:
    device = electromagnet_of(candidate)
    tool, angle = device.tool, device.workspace_half_angle
    magnet = RingMagnet(tool.outer_radius, tool.inner_radius, tool.length, tool.remanence)
    azimuth = np.arctan2(device.hall.positions[:, 1], device.hall.positions[:, 0])
    edge = np.column_stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth),
                            np.full(len(azimuth), np.cos(angle))])  # fmt: skip
    greatest = np.zeros(device.sensors)
    for axis in np.vstack([edge, cap_directions(angle, _DIRECTIONS)]):
        R = rotation_to_axis(axis)
        own = (device.hall.positions - device.contact_distance * axis) @ R
        greatest = np.maximum(greatest, np.abs(magnet.field(own) @ R.T).max(axis=1))
    coils = np.abs(coil_field(device)).max(axis=1) @ device.driven_current
    return float((greatest + coils).max())


QUANTITIES = (
    describe("sensing_error", "m", "minimise",
             "Rms over the shell of the Cramér–Rao bound of the position error of one sample: radial "
             "tool, currents off.", {_ELECTROMAGNET: _position}),
    describe("orientation_error", "rad", "minimise",
             "Rms over the workspace of the Cramér–Rao bound of the orientation error of one sample.",
             {_MOTOR: _orientation}),
    describe("sensor_clearance", "m", "maximise",
             "Smallest clearance around the field sensors (half a chip: chip of [evaluation]): to the dome, to each "
             "other, and "
             "to a pen (radius: pen) tilted from the radius by up to lean [rad] anywhere in the workspace.",
             {_ELECTROMAGNET: _room}),
    describe("sensor_field", "T", "minimise",
             "Upper bound of the reading of one axis of a field sensor: a radial tool in contact anywhere, and all "
             "coils at full "
             "current.", {_ELECTROMAGNET: _field}),
)  # fmt: skip
