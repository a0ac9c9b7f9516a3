"""Protocol of the Haply Inverse Service: an inventory for a new client, and the state in reply to every message."""

from __future__ import annotations

import json
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import isfinite, sqrt
from time import monotonic
from typing import Any, final

from haptorb.arrays import record
from haptorb.control.trip_reasons import GuardState
from haptorb.devices.base import Device
from haptorb.errors import HaptorbError, InputError, UnknownName
from haptorb.serve.base import MAX_WAIT_S, ServedDevice
from haptorb.version import __version__

__all__ = [
    "IDENTITY",
    "MAPPING",
    "PRESETS",
    "Basis",
    "Cursor",
    "DeviceCommand",
    "DeviceIds",
    "Service",
    "Session",
    "Settings",
    "Space",
    "Transform",
    "Vector",
    "default_space",
    "multiply",
    "parse_basis",
    "parse_transform",
    "read_device_force",
    "read_list",
    "rotate",
]


# --------------------------------------------------------------------------------------------------
# Coordinate transforms that clients configure: axes, mount and scale, for cursor and forces.
#
# The order is that of the Inverse Service's documentation: from the device's own frame (X to the right, Y forward, Z
# up) through the basis, which names the axes, then the mount, then the transform of the workspace, both in the axes
# that the basis names.


Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  #: x, y, z, w

_MAX_MOUNT_M = 1e3  #: largest coordinate of a mount [m], and largest scale [1]


def rotate(q: Quaternion, v: Sequence[float]) -> Vector:
    """Rotate `v` (3,) by the unit quaternion `q` (x, y, z, w); result in the unit of `v` [any]."""
    x, y, z, w = q
    a, b, c = v
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return (a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx)


def multiply(p: Quaternion, q: Quaternion) -> Quaternion:
    """Quaternion product (4,) (x, y, z, w) [1]: rotation `q`, then rotation `p`."""
    a, b, c, d = p
    x, y, z, w = q
    return (
        d * x + a * w + b * z - c * y,
        d * y - a * z + b * w + c * x,
        d * z + a * y - b * x + c * w,
        d * w - a * x - b * y - c * z,
    )


@dataclass(frozen=True)
class Transform:
    """Transform v → position + rotation · (scale v): a position [m], a rotation (x, y, z, w) and a scale per axis."""

    position: Vector = (0.0, 0.0, 0.0)
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    scale: Vector = (1.0, 1.0, 1.0)

    def place(self, p: Sequence[float]) -> Vector:
        """Transform a point (3,) [m]."""
        x, y, z = self.turn(p)
        return (x + self.position[0], y + self.position[1], z + self.position[2])

    def turn(self, v: Sequence[float]) -> Vector:
        """Transform a velocity (3,) [m/s]: scale and rotate."""
        a, b, c = self.scale
        return rotate(self.rotation, (a * v[0], b * v[1], c * v[2]))

    def pull_force(self, force: Sequence[float]) -> Vector:
        """Transform a force (3,) [N] from the client's frame back: rotated and mirrored, but not scaled."""
        x, y, z, w = self.rotation
        f = rotate((-x, -y, -z, w), force)
        a, b, c = (1.0 if one > 0.0 else -1.0 for one in self.scale)
        return (a * f[0], b * f[1], c * f[2])

    def push_force(self, force: Sequence[float]) -> Vector:
        """Transform a force (3,) [N] to the client's frame: the inverse of `pull_force`."""
        a, b, c = (1.0 if one > 0.0 else -1.0 for one in self.scale)
        return rotate(self.rotation, (a * force[0], b * force[1], c * force[2]))

    def as_json(self) -> dict[str, Any]:
        """Return the transform in the format of the Inverse Service."""
        return {
            "position": dict(zip("xyz", self.position, strict=True)),
            "rotation": dict(zip("xyzw", self.rotation, strict=True)),
            "scale": dict(zip("xyz", self.scale, strict=True)),
        }


IDENTITY = Transform()


@dataclass(frozen=True)
class Basis:
    """Axis permutation: the client's axis i is the service's axis `axes[i]` times `signs[i]`.

    `permutation` is its text.
    """

    permutation: str = "XYZ"
    axes: tuple[int, int, int] = (0, 1, 2)
    signs: Vector = (1.0, 1.0, 1.0)

    def name_axes(self, v: Sequence[float]) -> Vector:
        """Convert `v` (3,) to the client's axes, in its own unit [any]."""
        (i, j, k), (a, b, c) = self.axes, self.signs
        return (a * v[i], b * v[j], c * v[k])

    def undo(self, v: Sequence[float]) -> Vector:
        """Convert `v` (3,) from the client's axes to the service's, in its own unit [any]."""
        found = [0.0, 0.0, 0.0]
        for axis, sign, value in zip(self.axes, self.signs, v, strict=True):
            found[axis] = sign * value
        return (found[0], found[1], found[2])

    @property
    def hand(self) -> float:
        """Handedness of the client's axes: 1 for right-handed, −1 for left-handed."""
        even = self.axes in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
        return (1.0 if even else -1.0) * self.signs[0] * self.signs[1] * self.signs[2]

    def name_turn(self, q: Quaternion) -> Quaternion:
        """Convert the orientation `q` (x, y, z, w) to the client's axes; the rotation axis is mirrored with them."""
        x, y, z = self.name_axes(q[:3])
        return (self.hand * x, self.hand * y, self.hand * z, q[3])

    def name_transform(self, transform: Transform) -> Transform:
        """Convert `transform` from the device's own frame to the client's axes."""
        i, j, k = self.axes
        scale = (transform.scale[i], transform.scale[j], transform.scale[k])
        return Transform(self.name_axes(transform.position), self.name_turn(transform.rotation), scale)


def parse_basis(text: object) -> Basis:
    """Parse a basis such as "XZY" or "X-YZ". Raises InputError if it is no permutation of X, Y, Z.

    >>> parse_basis("X-YZ").name_axes((1.0, 2.0, 3.0))
    (1.0, -2.0, 3.0)
    """
    if not isinstance(text, str) or len(text) > 12:
        raise InputError(
            "a basis must be a permutation of X, Y and Z, each optionally preceded by + or -, such as 'XZY'"
        )
    axes, signs, sign = list[int](), list[float](), 1.0
    for letter in text.upper():
        if letter in "+-":
            sign = -1.0 if letter == "-" else 1.0
        else:
            axes.append("XYZ".find(letter))
            signs.append(sign)
            sign = 1.0
    if sorted(axes) != [0, 1, 2]:
        raise InputError(f"a basis names each of X, Y and Z once, such as 'XZY'; got '{text}'")
    return Basis(text.upper(), (axes[0], axes[1], axes[2]), (signs[0], signs[1], signs[2]))


def parse_transform(found: object, before: Transform = IDENTITY) -> Transform:
    """Parse a transform in the format of the Inverse Service; missing parts are taken from `before`.

    Raises InputError for numbers that are not finite, a rotation of length 0 or a scale of 0."""
    if isinstance(found, Mapping) and isinstance(found.get("transform"), Mapping):
        found = found["transform"]
    if not isinstance(found, Mapping):
        raise InputError("a transform is an object with position, rotation and scale")
    position = _read_numbers(found.get("position"), "xyz", before.position, "position")
    rotation = _read_numbers(found.get("rotation"), "xyzw", before.rotation, "rotation")
    scale = _read_numbers(found.get("scale"), "xyz", before.scale, "scale")
    length = sqrt(sum(one * one for one in rotation))
    if length < 1e-6:
        raise InputError("a rotation is a quaternion {x, y, z, w} that is not zero")
    if any(abs(one) < 1e-3 for one in scale):
        raise InputError("a scale is 0.001 or more along each axis, or -0.001 or less")
    x, y, z, w = (one / length for one in rotation)
    return Transform((position[0], position[1], position[2]), (x, y, z, w), (scale[0], scale[1], scale[2]))


def _read_numbers(found: object, names: str, before: Sequence[float], what: str) -> list[float]:
    if found is None:
        return list(before)
    if what == "scale" and isinstance(found, int | float) and not isinstance(found, bool):
        found = dict.fromkeys(names, found)
    if isinstance(found, Sequence) and not isinstance(found, str) and len(found) == len(names):
        found = dict(zip(names, found, strict=True))
    if not isinstance(found, Mapping):
        raise InputError(f"{what} is an object with {', '.join(names)}")
    numbers = [found.get(name, old) for name, old in zip(names, before, strict=True)]
    for one in numbers:
        if isinstance(one, bool) or not isinstance(one, int | float) or not -_MAX_MOUNT_M <= one <= _MAX_MOUNT_M:
            raise InputError(f"{what} has finite numbers, at most {_MAX_MOUNT_M:g} in size")
    found = [float(one) for one in numbers]
    assert all(map(isfinite, found))
    return found


# --------------------------------------------------------------------------------------------------
# The tool as a cursor: state of the newest row, with the last finite values.


@final
class Cursor:
    """Cursor state from the newest row of `served`; call `update` before reading it.

    place, velocity, force   of the tool, or of a motor's object, in the stator's frame [m, m/s, N]
    turn                     orientation of the tool or the handle, quaternion (x, y, z, w)
    tick                     rows published at the last update: an equal number means an unchanged cursor
    known                    whether a pose was ever valid
    ready, tripped           whether forces are rendered now; whether the guard has tripped
    derated                  whether the force is reduced because of warm coils
    damped                   whether the passivity control adds damping or softens the world
    trip                     code of the last trip's cause
    """

    def __init__(self, served: ServedDevice) -> None:
        self._served, layout = served, served.layout
        self._direct = not served.facts.get("modes")
        self._p = layout["p" if self._direct else "object"]
        self._v, self._q = layout["v"], layout["q"]
        self._force = layout["wrench_commanded" if self._direct else "object_wrench"].start
        self._t = layout["t"].start
        self._guard, self._trip, self._valid = layout["guard"].start, layout["trip"].start, layout["valid"].start
        self._injected, self._softened = layout["injected"].start, layout["softened"].start
        self.place: Vector = self._rest(served)
        self.velocity: Vector = (0.0, 0.0, 0.0)
        self.force: Vector = (0.0, 0.0, 0.0)
        self.turn: Quaternion = (0.0, 0.0, 0.0, 1.0)
        self.tick, self.t, self.trip = -1, 0.0, 0
        self.known = self.ready = self.tripped = self.derated = self.damped = False

    def _rest(self, served: ServedDevice) -> Vector:
        shell = served.device.shell
        return (0.0, 0.0, 0.0 if shell is None else shell.contact_distance)

    def update(self) -> None:
        """Read the newest row, if it is newer than the last one read."""
        served = self._served
        tick = served.tick_count
        if tick == self.tick or (row := served.latest()) is None:
            return
        self.tick = tick
        n = row.tolist()
        guard, trip = n[self._guard], n[self._trip]
        self.tripped = guard == GuardState.TRIPPED
        self.ready = guard in (GuardState.RAMPING, GuardState.RUNNING, GuardState.DERATED)
        self.derated = guard == GuardState.DERATED
        self.damped = n[self._injected] > 0.0 or n[self._softened] > 0.0
        self.trip = int(trip) if isfinite(trip) else 0
        if n[self._valid] != 1.0:
            self.velocity = self.force = (0.0, 0.0, 0.0)
            return
        x, y, z = n[self._p]
        if isfinite(x + y + z):
            if self._direct:
                self.velocity = self._check_vector(n[self._v])
            elif self.known and n[self._t] > self.t:  # rows have no velocity of a motor's object
                dt = n[self._t] - self.t
                a, b, c = self.place
                self.velocity = ((x - a) / dt, (y - b) / dt, (z - c) / dt)
            self.place, self.t, self.known = (x, y, z), n[self._t], True
        a, b, c, d = n[self._q]
        if isfinite(a + b + c + d):
            self.turn = (a, b, c, d)
        self.force = self._check_vector(n[self._force : self._force + 3])

    @staticmethod
    def _check_vector(numbers: list[float]) -> Vector:
        a, b, c = numbers
        return (a, b, c) if isfinite(a + b + c) else (0.0, 0.0, 0.0)


# --------------------------------------------------------------------------------------------------
# Mapping of this device's workspace to that of an Inverse3, which clients expect; clients can configure it.
#
# By default the tool's rest position, on top of the Omni's dome, maps to the centre of the Inverse3's workspace, and
# lengths are scaled by 2, because a shell of 10 cm represents a space of 20 cm. A motor's object moves by millimetres:
# there the scale is 10. Forces are not scaled, so the rendered stiffness is that of the client times the scale.


MAPPING = ("workspace", "basis", "preset", "mount", "transform")  #: settings of a client's space

#: centre of the Inverse3's workspace in the frame of its base, as assumed by public clients [m]
_WORKSPACE_CENTRE_M = (0.0, -0.14, 0.20)
_HALF_TURN_ABOUT_Z = (0.0, 0.0, 1.0, 0.0)
_LENGTH_SCALES = {True: 2.0, False: 10.0}  # for a tool over a shell, for a motor's object

#: name → mount in the device's own frame, after the Inverse Service's documentation
PRESETS: dict[str, Transform] = {
    "defaults": IDENTITY,
    "arm_front": IDENTITY,
    "arm_front_centered": Transform((-_WORKSPACE_CENTRE_M[0], -_WORKSPACE_CENTRE_M[1], -_WORKSPACE_CENTRE_M[2])),
    "led_front": Transform(rotation=_HALF_TURN_ABOUT_Z),
    "led_front_centered": Transform(
        (_WORKSPACE_CENTRE_M[0], _WORKSPACE_CENTRE_M[1], -_WORKSPACE_CENTRE_M[2]), _HALF_TURN_ABOUT_Z
    ),
}


@dataclass(frozen=True)
class Space:
    """Transform chain from the stator's frame to the frame of one client.

    workspace   from the stator's frame to the base frame of an Inverse3: the documented default, adjustable
    basis       axes of the client
    preset      name of the mount; "custom": the mount of the client
    own_mount   mount of the client, in its axes; used only with "custom"
    transform   of the workspace, in the client's axes; a client may move it at any time
    """

    workspace: Transform
    preset: str = "defaults"
    own_mount: Transform = IDENTITY
    transform: Transform = IDENTITY
    basis: Basis = field(default_factory=Basis)

    @cached_property
    def mount(self) -> Transform:
        """Mount of the Inverse3, in the client's axes."""
        return self.own_mount if self.preset == "custom" else self.basis.name_transform(PRESETS[self.preset])

    def place(self, p: Sequence[float]) -> Vector:
        """Transform a position `p` (3,) [m] from the stator's frame to the client's."""
        return self.transform.place(self.mount.place(self.basis.name_axes(self.workspace.place(p))))

    def velocity(self, v: Sequence[float]) -> Vector:
        """Transform a velocity (3,) [m/s] from the stator's frame to the client's."""
        return self.transform.turn(self.mount.turn(self.basis.name_axes(self.workspace.turn(v))))

    def force(self, force: Sequence[float]) -> Vector:
        """Transform a force (3,) [N] from the stator's frame to the client's."""
        return self.transform.push_force(self.mount.push_force(self.basis.name_axes(self.workspace.push_force(force))))

    def stator_force(self, force: Sequence[float]) -> Vector:
        """Transform a force (3,) [N] from the client's frame to the stator's."""
        return self.workspace.pull_force(self.basis.undo(self.mount.pull_force(self.transform.pull_force(force))))

    def orientation(self, q: Quaternion) -> Quaternion:
        """Transform an orientation `q` (x, y, z, w) from the stator's frame to the client's."""
        turned = self.basis.name_turn(multiply(self.workspace.rotation, q))
        return multiply(self.transform.rotation, multiply(self.mount.rotation, turned))

    def with_preset(self, name: object) -> Space:
        """Return a copy with the mount of the preset `name`. Raises UnknownName."""
        if name == "custom":
            return replace(self, preset="custom", own_mount=self.mount)
        if not isinstance(name, str) or name not in PRESETS:
            raise UnknownName("preset", str(name)[:100], [*PRESETS, "custom"])
        return replace(self, preset=name)

    def configure(self, found: Mapping[str, Any]) -> Space:
        """Return a copy with the settings in `found`: preset, basis, mount, transform, and our own `workspace`.

        Raises InputError for invalid settings, and for mount and preset together, as the Inverse Service does.
        """
        if "mount" in found and "preset" in found:
            raise InputError("mount and preset exclude each other: a preset is a mount with a name")
        space = self
        if "basis" in found:
            basis = found["basis"]
            space = replace(space, basis=parse_basis(basis.get("permutation") if isinstance(basis, Mapping) else basis))
        if "preset" in found:
            preset = found["preset"]
            space = space.with_preset(
                preset.get("preset", preset.get("name")) if isinstance(preset, Mapping) else preset
            )
        if "mount" in found:
            space = replace(space, preset="custom", own_mount=parse_transform(found["mount"], space.mount))
        if "transform" in found:
            space = replace(space, transform=parse_transform(found["transform"], space.transform))
        if "workspace" in found:
            space = replace(space, workspace=parse_transform(found["workspace"], space.workspace))
        return space


def default_space(device: Device) -> Space:
    """Default transform chain of a client of `device`."""
    shell = device.shell
    scale = _LENGTH_SCALES[shell is not None]
    rest = 0.0 if shell is None else shell.contact_distance
    x, y, z = _WORKSPACE_CENTRE_M
    return Space(Transform((x, y, z - scale * rest), scale=(scale, scale, scale)))


# --------------------------------------------------------------------------------------------------
# Parsing of the commands in a client's message, in all spellings that clients use; invalid entries are ignored.


_MAX_ENTRIES = 16  #: entries of one message that are read
_POSITION_STIFFNESS_N_PER_M = 40.0  #: of the spring to a commanded position [N/m]
_MAX_POSITION_FORCE_N = 1.0  #: largest force of that spring [N]


@record
class DeviceCommand:
    """Command of one message to the device.

    force      (3,) in the client's frame [N]; None: no force commanded
    transform  of the workspace, as the client wrote it; None: unchanged
    """

    force: Vector | None
    transform: object


def read_list(found: object) -> list[Mapping[str, Any]]:
    """Objects in an array of a message; a single object counts as an array of one."""
    if isinstance(found, Mapping):
        found = [found]
    return [one for one in found[:_MAX_ENTRIES] if isinstance(one, Mapping)] if isinstance(found, list) else []


def read_device_force(entry: Mapping[str, Any], space: Space, cursor: Cursor) -> DeviceCommand:
    """Parse one `entry` of `inverse3`; the forces of one message are added.

    A commanded position becomes the force of a weak spring, because this device is controlled by force.
    """
    total, transform = None, None
    for name in ("commands", "command"):
        for commands in read_list(entry.get(name)):
            force = _read_vector(commands.get("set_cursor_force"), ("vector", "values"))
            place = _read_vector(commands.get("set_cursor_position"), ("position", "values", "vector"))
            if place is not None:
                force = _add(force, _compute_spring_force(place, space.place(cursor.place)))
            if force is not None:
                total = _add(total, force)
            moved = commands.get("set_transform")
            transform = moved if isinstance(moved, Mapping) else transform
    return DeviceCommand(total, transform)


def _read_vector(found: object, names: tuple[str, ...]) -> Vector | None:
    if not isinstance(found, Mapping):
        return None
    for name in names:
        if isinstance(inner := found.get(name), Mapping | list):
            found = inner
            break
    if isinstance(found, list):
        found = dict(zip("xyz", found, strict=False))
    if not any(name in found for name in "xyz"):
        return None
    numbers = []
    for name in "xyz":
        number = found.get(name, 0.0)
        if isinstance(number, bool) or not isinstance(number, int | float):
            return None
        try:
            number = float(number)
        except OverflowError:
            return None
        if not isfinite(number):
            return None
        numbers.append(number)
    return (numbers[0], numbers[1], numbers[2])


def _add(a: Vector | None, b: Vector) -> Vector:
    return b if a is None else (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _compute_spring_force(place: Vector, now: Vector) -> Vector:
    ways = [goal - here for goal, here in zip(place, now, strict=True)]
    size = sum(way * way for way in ways) ** 0.5
    share = min(_POSITION_STIFFNESS_N_PER_M, _MAX_POSITION_FORCE_N / size) if size > 0.0 else 0.0
    return (share * ways[0], share * ways[1], share * ways[2])


# --------------------------------------------------------------------------------------------------
# Device ids and config in the format of the Inverse Service, as far as this device supports them.


@dataclass(frozen=True)
class DeviceIds:
    """Ids of the tool and its grip for clients: hexadecimal digits, constant for a device."""

    device: str
    grip: str
    unique: str

    @classmethod
    def of(cls, device: Device) -> DeviceIds:
        """Derive the ids from the digest of the file of `device`."""
        digits = device.digest.upper()
        return cls(digits[:4], digits[4:8], str(uuid.uuid5(uuid.NAMESPACE_URL, f"haptorb:{device.digest}")))

    def is_meant(self, given: object) -> bool:
        """Whether a command with the id `given` addresses the tool: its id as text or number, or no id, which clients
        send before they know it."""
        if given is None or given in ("", "*", 0, "0"):
            return True
        if isinstance(given, str):
            return given.upper().removeprefix("0X").rjust(len(self.device), "0") == self.device
        return isinstance(given, int) and given == int(self.device, 16)


@dataclass(frozen=True)
class Settings:
    """Settings of the device other than its space.

    Handedness, damping and gate are stored and reported but do not affect the force, which is limited by this device's
    guard and passivity control. `navigation` is ignored: the workspace is small.
    """

    handedness: str = "right"
    damping: Mapping[str, Any] = field(default_factory=lambda: {"scalar": 0.0})
    gate: float = 1.0

    def configure(self, found: Mapping[str, Any]) -> Settings:
        """Return a copy with the settings in `found`. Raises InputError for invalid and for unsupported settings."""
        settings = self
        if "handedness" in found:
            hand = found["handedness"]
            hand = hand.get("handedness") if isinstance(hand, Mapping) else hand
            if hand not in ("left", "right"):
                raise InputError("handedness is 'left' or 'right'")
            settings = replace(settings, handedness=hand)
        filters = found.get("filters")
        both = {**(filters if isinstance(filters, Mapping) else {}), **found}
        if "damping" in both:
            settings = replace(settings, damping=_read_damping(both["damping"]))
        if "force_gate" in both:
            settings = replace(settings, gate=_read_fraction(both["force_gate"], "gain", "force_gate"))
        for name in ("gravity_compensation", "torque_scaling", "home_return"):
            wanted = found.get(name)
            if wanted is True or (isinstance(wanted, Mapping) and wanted.get("enabled") is True):
                raise InputError(
                    f"this device has no {name}: a spherical electromagnet has no arm that it could act on"
                )
        return settings

    def as_json(self, identity: DeviceIds, space: Space) -> dict[str, Any]:
        """Return the `config` of the device in an inventory, for a client with `space`."""
        return {
            "type": "inverse3",
            "handedness": self.handedness,
            "port": "haptorb",
            "streaming_mode": "USB",
            "device_info": {
                "major_version": 3,
                "minor_version": 5,
                "id": identity.device,
                "device_type": 4,
                "uuid": identity.unique,
            },
            "extended_device_id": identity.unique,
            "extended_firmware_version": __version__,
            "gravity_compensation": {"enabled": False, "scaling_factor": 0.0},
            "torque_scaling": {"enabled": False},
            "home_return": {"enabled": False},
            "preset": space.preset,
            "basis": {"permutation": space.basis.permutation},
            "mount": space.mount.as_json(),
            "transform": space.transform.as_json(),
            "workspace": space.workspace.as_json(),
            "filters": {"force_gate": {"gain": self.gate}, "damping": dict(self.damping)},
        }

    def as_command(self, name: str, identity: DeviceIds, space: Space) -> dict[str, Any]:
        """Return the config `name` in the format of a command that sets it.

        There the Inverse Service wraps transforms and names of presets in objects, unlike in its inventory."""
        known = self.as_json(identity, space)
        found = known["filters"].get(name, known.get(name))
        if name in ("mount", "transform", "workspace"):
            return {"transform": found}
        return dict(found) if isinstance(found, Mapping) else {name: found}


def _read_fraction(found: object, name: str, what: str) -> float:
    number = found.get(name) if isinstance(found, Mapping) else found
    if isinstance(number, bool) or not isinstance(number, int | float) or not 0.0 <= number <= 1.0:
        raise InputError(f"{what} is a number from 0 to 1, or an object with {name}")
    return float(number)


def _read_damping(found: object) -> dict[str, Any]:
    """Parse damping: a scalar, a vector of fractions along the axes, or both."""
    vector = found.get("vector") if isinstance(found, Mapping) else None
    if not isinstance(vector, Mapping):
        return {"scalar": _read_fraction(found, "scalar", "damping")}
    scalar = (
        {"scalar": _read_fraction(found, "scalar", "damping")}
        if isinstance(found, Mapping) and "scalar" in found
        else {}
    )
    return {
        **scalar,
        "vector": {axis: _read_fraction(vector.get(axis, 0.0), "", f"damping along {axis}") for axis in "xyz"},
    }


# --------------------------------------------------------------------------------------------------
# Sessions: one per client connection, with number, name, space and message rate; and the service for all of them.


_MAX_NAME_CHARACTERS = 60  #: of a client's profile [characters]
_RATE_SMOOTHING = 0.5  #: weight of the newest rate
_SAME_MAPPING_TOLERANCE = 0.087  #: change of a unit force up to which its mapping counts as the same: 5°


@final
class Session:
    """Session `number` of a client at the IP address `peer`, with the transform chain `space`.

    unreadable  invalid messages so far; an empty message is valid
    refused     whether it was informed, since its last accepted command, that another client controls the device
    """

    def __init__(self, number: int, peer: str, space: Space) -> None:
        self.number, self.peer, self.space = number, peer, space
        self.mapping = 0  #: counts changes of its mapping, after which the same command has another direction
        self._axes = _force_axes(space)
        self.name = ""
        self.messages = self.unreadable = 0
        self.rate = 0.0  #: messages per second
        self.refused = False
        self._since, self._counted = monotonic(), 0

    def change_space(self, space: Space) -> None:
        """Set `space`; a different one counts as a new mapping, because the direction of its force changes."""
        if space != self.space:
            self.space, self._axes = space, _force_axes(space)
            self.mapping += 1  # safety: mapping-counts

    def move_space(self, space: Space) -> None:
        """As `change_space`, for a transform that a client moves while it commands.

        Successive small rotations count as the same mapping, because the guard limits how fast the force may turn."""
        self.space = space
        axes = _force_axes(space)
        if max(abs(a - b) for a, b in zip(axes, self._axes, strict=True)) > _SAME_MAPPING_TOLERANCE:
            self._axes = axes
            self.mapping += 1

    def rename(self, name: object) -> None:
        """Set the name of its profile, printable and cut to the length that a list of clients can show."""
        if isinstance(name, str):
            self.name = "".join(letter for letter in name if letter.isprintable())[:_MAX_NAME_CHARACTERS]

    def measure(self) -> float:
        """Message rate [1/s], smoothed over the last calls."""
        now = monotonic()
        passed = now - self._since
        if passed > 0.0:
            newest = (self.messages - self._counted) / passed
            self.rate += (newest - self.rate) * (_RATE_SMOOTHING if self.rate else 1.0)
            self._since, self._counted = now, self.messages
        return self.rate


def _force_axes(space: Space) -> tuple[float, ...]:
    """Directions of unit forces along the client's axes in the stator's frame, nine numbers."""
    return tuple(part for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1)) for part in space.stator_force(axis))


@final
class Service:
    """Service for all clients of the device `served`; `send_event` takes name, category, level, data, message."""

    def __init__(self, served: ServedDevice, send_event: Callable[..., None]) -> None:
        self.served, self.send_event = served, send_event
        self.sessions: dict[int, Session] = {}
        self.identity = DeviceIds.of(served.device)
        self.settings = Settings()
        self.space: Space = default_space(served.device)  #: default for new clients
        self.cursor = Cursor(served)
        self._tick, self._texts = -1, dict[tuple[int | bool, ...], tuple[Space, str]]()

    def open(self, peer: str) -> Session:
        """Open a session for a client at the IP address `peer`."""
        session = Session(self.served.open_session(), peer, self.space)
        self.sessions[session.number] = session
        self.send_event("session-connected", "session", "info", {"session_id": session.number})
        return session

    def close(self, session: Session) -> None:
        """Close the session of a lost connection, which ends its force."""
        if self.sessions.pop(session.number, None) is not None:
            self.served.lose(session.number)
            self.send_event("session-disconnected", "session", "info", {"session_id": session.number})

    def inventory(self, session: Session) -> str:
        """Encode the inventory, which is sent to a new client without request."""
        return self._write(session, config=True, inventory=True)

    def answer(self, session: Session, text: str | bytes, arrival: float) -> str:
        """Execute a client's message, which arrived at `arrival` on the monotonic clock [s], and encode the reply.

        The reply is always the state. A message that waited too long is answered but not executed."""
        session.messages += 1
        self.cursor.update()
        try:
            message = json.loads(text)
        except (ValueError, RecursionError):
            message, session.unreadable = None, session.unreadable + bool(text.strip())
        late = monotonic() - arrival > MAX_WAIT_S  # safety: late-messages
        full = self._execute(session, message, arrival) if isinstance(message, dict) and not late else False
        return self._write(session, config=full)

    def _execute(self, session: Session, message: dict[str, Any], arrival: float) -> bool:
        """Execute the valid parts of `message`; returns whether the reply must include the config."""
        full = False
        wanted = message.get("session")
        if isinstance(wanted, Mapping):
            full = "force_render_full_state" in wanted
            self._configure_session(session, wanted.get("configure"))
        force: list[float] | None = None
        for entry in read_list(message.get("inverse3")):
            if not self.identity.is_meant(entry.get("device_id")):
                continue
            if isinstance(given := entry.get("configure"), Mapping):
                self._apply_if_valid(partial(self.configure, session, given, by=session))
            found = read_device_force(entry, session.space, self.cursor)
            if found.transform is not None:
                self._apply_if_valid(partial(self._set_transform, session, found.transform))
            if found.force is not None:
                force = [a + b for a, b in zip(force or (0.0, 0.0, 0.0), found.force, strict=True)]
        if force is not None:
            self._command(session, force, arrival)
        return full

    def _command(self, session: Session, force: list[float], arrival: float) -> None:
        stator = session.space.stator_force(force)
        refusals = self.served.busy
        if self.served.command(session.number, stator, arrival=arrival, mapping=session.mapping):
            session.refused = False
        elif self.served.busy > refusals and not session.refused:
            session.refused = True  # reported once, not with each of a thousand commands a second
            self.send_event(
                "device-busy", "device", "warning",
                {
                    "device_family": "inverse", "device_id": self.identity.device,
                    "session_id": session.number, "holder": self.served.holder,
                },
                "another session commands this device; this one may watch",
            )  # fmt: skip

    def _configure_session(self, session: Session, given: object) -> None:
        if not isinstance(given, Mapping):
            return
        profile = given.get("profile")
        if isinstance(profile, Mapping):
            session.rename(profile.get("name"))
        for found in (given, profile):
            if isinstance(found, Mapping) and "basis" in found:
                basis = found["basis"]
                text = basis.get("permutation") if isinstance(basis, Mapping) else basis
                self._apply_if_valid(partial(self._set_basis, session, text))

    def _set_basis(self, session: Session, text: object) -> None:
        session.change_space(replace(session.space, basis=parse_basis(text)))

    def _set_transform(self, session: Session, given: object) -> None:
        session.move_space(replace(session.space, transform=parse_transform(given, session.space.transform)))

    def configure(self, session: Session | None, found: Mapping[str, Any], *, by: Session | None = None) -> None:
        """Configure one session, or, for None, all present and future ones; `by` is the requesting session, None for
        an HTTP request. Raises InputError for invalid settings; then nothing changes.

        Only the client that controls the device may change its own mapping, because its force would turn.
        """
        changed = list(self.sessions.values()) if session is None else [session]
        holder = self.served.holder
        concerned = holder and any(one.number == holder for one in changed) and (by is None or by.number != holder)
        if concerned and any(name in found for name in MAPPING):  # safety: holder-maps
            raise InputError(
                f"session {holder} commands the device, and only its own messages change how it sees it: wait until "
                "it has let the device go (2 s after its last command), or name another session"
            )
        spaces = [one.space.configure(found) for one in changed]
        later = self.space.configure(found) if session is None else self.space
        self.settings, self.space = self.settings.configure(found), later
        for one, space in zip(changed, spaces, strict=True):
            one.change_space(space)

    @staticmethod
    def _apply_if_valid(change: Callable[[], None]) -> None:
        """Apply `change`; an invalid one is ignored, because the reply is always the state."""
        try:
            change()
        except HaptorbError:
            return

    def _write(self, session: Session, *, config: bool, inventory: bool = False) -> str:
        cursor = self.cursor
        cursor.update()
        holder, buttons = self.served.holder, self.served.buttons
        if not config and not inventory:
            return self._write_state(session.space, holder, buttons)
        return json.dumps({"session_id": session.number, **self._describe_all(session.space, holder, buttons)})

    def list_devices(self, space: Space) -> dict[str, Any]:
        """Config, state and status of all devices for a client with `space`."""
        self.cursor.update()
        return self._describe_all(space, self.served.holder, self.served.buttons)

    def _describe_all(self, space: Space, holder: int, buttons: dict[str, bool]) -> dict[str, Any]:
        state = self._describe(space, holder, buttons)
        state["inverse3"][0]["config"] = self.settings.as_json(self.identity, space)
        state["wireless_verse_grip"][0]["config"] = {"type": "wireless_verse_grip", "handedness": "right"}
        return state

    def _write_state(self, space: Space, holder: int, buttons: dict[str, bool]) -> str:
        """Encode the state for clients with `space`, once per tick."""
        if self._tick != self.cursor.tick:
            self._tick, self._texts = self.cursor.tick, {}
        # The entry holds a reference to the space, so that no other one can have its id within the tick.
        key = (id(space), holder, *buttons.values())
        found = self._texts.get(key)
        if found is None:
            found = self._texts[key] = (space, json.dumps(self._describe(space, holder, buttons)))
        return found[1]

    def _describe(self, space: Space, holder: int, buttons: dict[str, bool]) -> dict[str, Any]:
        cursor = self.cursor
        place, force = _point(space.place(cursor.place)), _point(space.force(cursor.force))
        x, y, z, w = space.orientation(cursor.turn)
        turn = {"w": w, "x": x, "y": y, "z": z}
        mode = "force" if holder else "idle"
        still = {"a0": 0.0, "a1": 0.0, "a2": 0.0}  # this device has no joints
        return {
            "inverse3": [
                {
                    "device_id": self.identity.device,
                    "state": {
                        "cursor_position": place,
                        "cursor_velocity": _point(space.velocity(cursor.velocity)),
                        "current_cursor_force": force,
                        "current_cursor_position": place,
                        "angular_position": still,
                        "angular_velocity": still,
                        "current_angular_position": still,
                        "current_angular_torques": still,
                        "body_orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
                        "control_domain": "cartesian",
                        "control_mode": mode,
                        "mode": mode,
                        "transform": space.transform.as_json(),
                    },
                    "status": {
                        "calibrated": cursor.known,
                        "in_use": holder != 0,
                        "power_supply": not cursor.tripped,
                        "ready": cursor.ready and self.served.renders_force,
                        "started": True,
                    },
                }
            ],
            "verse_grip": [],
            "wireless_verse_grip": [
                {
                    "device_id": self.identity.grip,
                    "state": {"orientation": turn, "buttons": buttons, "battery_level": 1.0, "hall": 0},
                    "status": {"connected": True, "awake": True, "ready": cursor.known},
                }
            ],
            "custom_verse_grip": [],
        }


def _point(v: tuple[float, float, float]) -> dict[str, float]:
    return {"x": v[0], "y": v[1], "z": v[2]}
