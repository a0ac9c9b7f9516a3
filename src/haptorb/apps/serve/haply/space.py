"""Where a client of that service sees the tool: the device's space in the place of the other device's, adjustable.

By default the tool's place of rest, on top of the Omni's dome, is the middle of the other device's workspace, and ways
are seen twice as long, because a shell of 10 cm takes the place of a space of 20 cm. A motor's target moves by
millimetres, and is seen ten times as far. Forces keep their size: so a client's stiffness is felt that much greater.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from haptorb.apps.serve.haply.transform import (
    IDENTITY,
    Basis,
    Quaternion,
    Transform,
    Vector,
    multiply,
    parse_basis,
    parse_transform,
)
from haptorb.devices.device import Device
from haptorb.errors import InputError, UnknownName

__all__ = ["MAPPING", "PRESETS", "Space", "default_space"]

MAPPING = ("workspace", "basis", "preset", "mount", "transform")  #: what a client can set of its space

#: the middle of the other device's workspace in the frame of its base, as public clients place what they draw [m]
_MIDDLE = (0.0, -0.14, 0.20)
_ABOUT_Z = (0.0, 0.0, 1.0, 0.0)  # half a turn
_SCALES = {True: 2.0, False: 10.0}  # of a tool over a shell, of a motor's target

#: name → mount in the device's own frame, as that service's documentation describes them
PRESETS: dict[str, Transform] = {
    "defaults": IDENTITY,
    "arm_front": IDENTITY,
    "arm_front_centered": Transform((-_MIDDLE[0], -_MIDDLE[1], -_MIDDLE[2])),
    "led_front": Transform(rotation=_ABOUT_Z),
    "led_front_centered": Transform((_MIDDLE[0], _MIDDLE[1], -_MIDDLE[2]), _ABOUT_Z),
}


@dataclass(frozen=True)
class Space:
    """How one client sees the device.

    workspace   from the stator's frame into that of the other device's base: the documented default, adjustable
    basis       the client's axes
    preset      name of the mount; "custom": that of the client
    own_mount   the client's, in its axes; only "custom" uses it
    transform   of the workspace, in the client's axes, which a client moves while it runs
    """

    workspace: Transform
    preset: str = "defaults"
    own_mount: Transform = IDENTITY
    transform: Transform = IDENTITY
    basis: Basis = field(default_factory=Basis)

    @cached_property
    def mount(self) -> Transform:
        """Of the other device, in the client's axes."""
        return self.own_mount if self.preset == "custom" else self.basis.name_transform(PRESETS[self.preset])

    def place(self, p: Sequence[float]) -> Vector:
        """Of the tool at `p` (3,) [m] in the stator's frame."""
        return self.transform.place(self.mount.place(self.basis.name_axes(self.workspace.place(p))))

    def velocity(self, v: Sequence[float]) -> Vector:
        """Of the tool's velocity (3,) [m/s] in the stator's frame."""
        return self.transform.turn(self.mount.turn(self.basis.name_axes(self.workspace.turn(v))))

    def force(self, force: Sequence[float]) -> Vector:
        """Of a force (3,) [N] in the stator's frame."""
        return self.transform.push_force(self.mount.push_force(self.basis.name_axes(self.workspace.push_force(force))))

    def stator_force(self, force: Sequence[float]) -> Vector:
        """A client's force (3,) [N] in the stator's frame."""
        return self.workspace.pull_force(self.basis.undo(self.mount.pull_force(self.transform.pull_force(force))))

    def orientation(self, q: Quaternion) -> Quaternion:
        """Of the tool's orientation `q` (x, y, z, w) in the stator's frame."""
        turned = self.basis.name_turn(multiply(self.workspace.rotation, q))
        return multiply(self.transform.rotation, multiply(self.mount.rotation, turned))

    def with_preset(self, name: object) -> Space:
        """With the mount of a preset. Raises UnknownName."""
        if name == "custom":
            return replace(self, preset="custom", own_mount=self.mount)
        if not isinstance(name, str) or name not in PRESETS:
            raise UnknownName("preset", str(name)[:100], [*PRESETS, "custom"])
        return replace(self, preset=name)

    def configure(self, found: Mapping[str, Any]) -> Space:
        """With what `found` sets of preset, basis, mount, transform, and this server's own `workspace`.

        Raises InputError for what cannot be, and for mount and preset together: that service refuses them, too.
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
    """How clients see `device` unless they say otherwise."""
    shell = device.shell
    scale = _SCALES[shell is not None]
    rest = 0.0 if shell is None else shell.contact_distance
    x, y, z = _MIDDLE
    return Space(Transform((x, y, z - scale * rest), scale=(scale, scale, scale)))
