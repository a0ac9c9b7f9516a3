"""One record per kind of device: everything that differs between kinds.

A class of devices names its record (`Device.kind`), so it is available wherever the device is, including the
servo's process. A part is a callable, or "module:name", which is imported when it is first needed. So a record
may name parts of higher layers, and reading a device file loads none of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final

from haptorb.errors import InputError

__all__ = ["DeviceKind", "Part", "kind_names", "kind_of_name", "load_part", "register"]

Part = str | Callable[..., Any]


def load_part(part: Part) -> Any:
    """The callable `part`, or the one at "module:name"."""
    if not isinstance(part, str):
        return part
    module, _, name = part.partition(":")
    return getattr(import_module(module), name)


@dataclass(frozen=True, kw_only=True)
class DeviceKind:
    """Record of one kind of device. If an optional part is None, programs that need it refuse such devices.

    name           as `kind` in a device file
    title          in sentences: "spherical motor", or for several "spherical motors"
    world          name of the default world
    allocator      (device) → Allocator
    wrench_choice  (device, part or None, arm or None) → WrenchChoice, for a kind that can render force, torque or both
    part_remarks   (device, WrenchChoice) → a remark for each part that can be rendered
    estimators     (device) → {name: EstimatorChoice}, the default first
    linkage        (device, gains or None) → Linkage
    modes          names of the linkage's modes; empty for a direct one
    contacts       number of contacts of a `ContactWorld` in its rows, filled by the linkage
    simulation     (device, seed) → Simulation, for the driver "sim"
    guide          (device) → Guide: motion of the simulated hand before a person points; by default it rests
    file           class of its device file (pydantic), with `build(assumed, digest, override=…)`; None: Python only
    tables         (device, report) → data for `device.tables` that take long to compute
    geometry       (device) → Geometry: bodies and positions, for `haptorb show` and the console
    scene          (device) → JSON for the console, with "kind": one of the page's scenes; None: axes
    force_map      (device) → process that computes the force map on the dome in the console
    card           (device) → Card of `haptorb inspect`
    errors         (device, wrench asked, estimator, calibration) → ErrorModel of `haptorb inspect --errors`
    hold           (device, hand) → HeldMover, for a kind that a scene can be coupled to
    workspace      (device) → Workspace of `haptorb check --world`
    boundary       largest stable stiffness of the simulated loop, for `haptorb check --world NAME --plot FILE`
    """

    name: str
    title: str
    world: str
    allocator: Part
    wrench_choice: Part | None = None
    part_remarks: Part | None = None
    estimators: Part = "haptorb.sensing.estimator:tracker_only"
    linkage: Part = "haptorb.control.clutch.linkage:make_direct_linkage"
    modes: tuple[str, ...] = ()
    contacts: int = 0
    simulation: Part | None = None
    guide: Part = "haptorb.runtime.pointer.guide:AtRest"
    file: Part | None = None
    tables: Part | None = None
    geometry: Part | None = None
    scene: Part | None = None
    force_map: Part | None = None
    card: Part | None = None
    errors: Part | None = None
    hold: Part | None = None
    workspace: Part | None = None
    boundary: Part | None = None

    def part(self, name: str) -> Any:
        """The callable of part `name`; None if this kind has none."""
        part = getattr(self, name)
        return None if part is None else load_part(part)

    def require_part(self, name: str, device: str, what: str) -> Any:
        """The callable of part `name`; InputError that states which kinds support `what`, if this kind has none."""
        found = self.part(name)
        if found is None:
            able = [f"{kind.title}s" for kind in map(kind_of_name, KINDS) if getattr(kind, name) is not None]
            raise InputError(f"device '{device}' is a {self.title}; {what} works for {' and '.join(able)}")
        return found


#: name → record, or where it stands
KINDS: Final[dict[str, DeviceKind | str]] = {
    "spherical-electromagnet": "haptorb.devices.electromagnet.kind:ELECTROMAGNET",
    "spherical-motor": "haptorb.devices.motor.kind:MOTOR",
    "coil-array": "haptorb.devices.coil_array.kind:COIL_ARRAY",
}


def register(kind: DeviceKind) -> None:
    """Make device files of `kind` known to the loader. Devices made in Python need no registration.

    Raises InputError for a name that another record already has.
    """
    KINDS.setdefault(kind.name, kind)
    if kind_of_name(kind.name) != kind:
        raise InputError(f"there is a kind of device '{kind.name}' already; choose another name")


def kind_names() -> tuple[str, ...]:
    """Valid values of `kind` in a device file."""
    return tuple(KINDS)


def kind_of_name(name: str) -> DeviceKind:
    """The record of that name; KeyError for another."""
    found = KINDS[name]
    kind: DeviceKind = load_part(found) if isinstance(found, str) else found
    return kind
