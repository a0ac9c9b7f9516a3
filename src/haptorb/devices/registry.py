"""Kinds of device by the name in a device file, with the schema of that file.

A kind of haptorb is loaded when a file names it. An installed package adds its own by an entry point of the group
`haptorb.kinds`, whose name is that of the kind and whose object is its `DeviceKind`; a program registers one.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points

from pydantic import BaseModel

from haptorb.devices.base import DeviceKind
from haptorb.devices.schema import DeviceSchema
from haptorb.errors import DeviceError, InputError, quote

__all__ = ["REGISTERED", "find_file", "has_file", "is_kind", "kind_names", "kind_of_name", "register"]


def _load_electromagnet() -> tuple[DeviceKind, type[DeviceSchema]]:
    from haptorb.devices.electromagnet import ELECTROMAGNET
    from haptorb.devices.electromagnet_file import ElectromagnetFile

    return ELECTROMAGNET, ElectromagnetFile


def _load_motor() -> tuple[DeviceKind, type[DeviceSchema]]:
    from haptorb.devices.motor import MOTOR
    from haptorb.devices.motor_file import MotorFile

    return MOTOR, MotorFile


def _load_coil_array() -> tuple[DeviceKind, type[DeviceSchema]]:
    from haptorb.devices.coil_array import COIL_ARRAY
    from haptorb.devices.coil_array_file import CoilArrayFile

    return COIL_ARRAY, CoilArrayFile


def _load_arm() -> tuple[DeviceKind, type[DeviceSchema]]:
    from haptorb.devices.arm import ARM
    from haptorb.devices.arm_file import ArmFile

    return ARM, ArmFile


#: haptorb's own kinds: name → loads record and schema
_KINDS: dict[str, Callable[[], tuple[DeviceKind, type[DeviceSchema]]]] = {
    "spherical-electromagnet": _load_electromagnet,
    "spherical-motor": _load_motor,
    "coil-array": _load_coil_array,
    "arm": _load_arm,
}

#: kinds of this process's program, by name
REGISTERED: dict[str, DeviceKind] = {}


def register(kind: DeviceKind) -> None:
    """Make device files of a kind known to this program.

    Devices made in Python need no registration, and neither does a kind of an installed package with an entry point of
    the group `haptorb.kinds`.

    Parameters
    ----------
    kind : DeviceKind
        Record of the kind.

    Raises
    ------
    InputError
        If another record has this name.
    """
    if (kind_of_name(kind.name) if is_kind(kind.name) else kind) != kind:
        raise InputError(f"there is a kind of device '{kind.name}' already; choose another name")
    REGISTERED.setdefault(kind.name, kind)


def kind_names() -> tuple[str, ...]:
    """Return the valid values of `kind` in a device file."""
    return tuple(dict.fromkeys([*_KINDS, *REGISTERED, *_list_installed()]))


def is_kind(name: str) -> bool:
    """Whether there is a kind of that name. Installed packages are looked through last: it takes milliseconds."""
    return name in _KINDS or name in REGISTERED or name in _list_installed()


def kind_of_name(name: str) -> DeviceKind:
    """Return the record of that name. Raises KeyError for another, DeviceError for one that a package breaks."""
    return _find(name)[0]


def has_file(name: str) -> bool:
    """Whether devices of the kind of that name have files; others are made in Python. Raises as `kind_of_name`."""
    return _find(name)[1] is not None


def find_file(name: str, device: str) -> type[DeviceSchema]:
    """Return the schema of the files of the kind of that name.

    Raises InputError, which names `device`, for a kind without files, else as `kind_of_name`.
    """
    kind, file = _find(name)
    if file is None:
        raise InputError(f"device '{device}' is a {kind.title}, which has no device file: it is made in Python")
    if not issubclass(file, DeviceSchema):
        raise InputError(f"file of kind '{kind.name}' must be a subclass of haptorb.devices.DeviceFile")
    return file


def _find(name: str) -> tuple[DeviceKind, type[BaseModel] | None]:
    """Return record and schema of the kind of that name.

    haptorb's own schemas make devices of their kind, whose record therefore cannot hold them: an import in a circle.
    """
    if name in _KINDS:
        return _KINDS[name]()
    kind = REGISTERED[name] if name in REGISTERED else _load_installed(_list_installed()[name])
    return kind, kind.file


def _list_installed() -> dict[str, EntryPoint]:
    """Return name → entry point of the kinds of installed packages."""
    return {found.name: found for found in entry_points(group="haptorb.kinds")}


def _load_installed(found: EntryPoint) -> DeviceKind:
    """Return the record at an entry point. Raises DeviceError if there is none."""
    try:
        kind = found.load()
    except Exception as cause:  # another package may raise anything
        raise DeviceError(f"kind of device '{found.name}' ({found.value}) cannot be loaded: {quote(cause)}") from cause
    if not isinstance(kind, DeviceKind) or kind.name != found.name:
        raise DeviceError(f"kind of device '{found.name}': {found.value} must be a DeviceKind with that name")
    return kind
