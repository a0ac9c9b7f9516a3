"""One record per kind of device: everything that programs do differently for one kind than for another.

A class of devices names its record (`Device.kind`), so a device carries it wherever it goes, into the servo's process
too. A part is a callable, or the place of one as "module:name", which is imported when the part is first needed: so a
record may name parts of layers far above this one, and reading a device file loads none of them.
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
    """The callable that `part` is, or that stands at "module:name"."""
    if not isinstance(part, str):
        return part
    module, _, name = part.partition(":")
    return getattr(import_module(module), name)


@dataclass(frozen=True, kw_only=True)
class DeviceKind:
    """What is known of one kind of device. An optional part that is None: programs that need it refuse such devices.

    name           as `kind` in a device file
    title          in sentences: "spherical motor", or for several "spherical motors"
    world          name of the world that shows such a device best
    allocator      (device) → Allocator
    wrench_choice  (device, part or None, arm or None) → WrenchChoice, for a kind that can render force, torque or both
    part_remarks   (device, WrenchChoice) → a text for each part that can be rendered
    estimators     (device) → {name: EstimatorChoice}, the default first
    linkage        (device, gains or None) → Linkage
    modes          names of the linkage's modes; empty for one that acts directly
    contacts       how many contacts of a `ContactWorld` its rows have room for; the linkage says what they do
    simulation     (device, seed) → Simulation, for the driver "sim"
    guide          (device) → Guide: what the simulated hand does before somebody points; by default it rests
    file           class of its device file (pydantic), with `build(assumed, digest, override=…)`; None: Python only
    tables         (device, report) → what is stored as `device.tables`, where computing it takes long
    geometry       (device) → Geometry: bodies and places, for `haptorb show` and the console's picture
    scene          (device) → JSON for the console's picture, with "kind": one of the page's scenes; None: axes
    force_map      (device) → process that computes the force painted on the dome of the console's picture
    card           (device) → Card of `haptorb inspect`
    errors         (device, wrench asked, estimator, calibration) → ErrorModel of `haptorb inspect --errors`
    hold           (device, hand) → HeldMover, for a kind that a scene can be coupled to
    workspace      (device) → Workspace of `haptorb check --world`
    boundary       largest stiffness of the simulated chain, as `haptorb check --world --plot` tries it
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
        """The callable of part `name`; None where this kind has none."""
        part = getattr(self, name)
        return None if part is None else load_part(part)

    def require_part(self, name: str, device: str, what: str) -> Any:
        """The callable of part `name`; InputError, saying for which kinds `what` works, where this kind has none."""
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

    Raises InputError for a name that another record has already.
    """
    KINDS.setdefault(kind.name, kind)
    if kind_of_name(kind.name) != kind:
        raise InputError(f"there is a kind of device '{kind.name}' already; choose another name")


def kind_names() -> tuple[str, ...]:
    """What `kind` in a device file may be."""
    return tuple(KINDS)


def kind_of_name(name: str) -> DeviceKind:
    """The record of that name; KeyError for another."""
    found = KINDS[name]
    kind: DeviceKind = load_part(found) if isinstance(found, str) else found
    return kind
