"""The device that a recording was made with, from the text of its file that the recording carries."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from haptorb.devices.device import Device
from haptorb.devices.device_text import DeviceText
from haptorb.devices.loader import catalogue, load, parse
from haptorb.errors import HaptorbError, InputError

__all__ = ["find_device"]


def find_device(path: Path, note: Mapping[str, str], name: str | None) -> tuple[Device, str]:
    """The device, and what a person should know about where it came from (else "").

    note  of the recording, on its device
    name  of a device, or path of its file, that overrides the recording's; None: the recording's

    Raises DeviceError or UnknownName for a wrong `name`, InputError where the device is unknown.
    """
    if name is not None:
        device = load(name)
        digest = note.get("digest", device.digest)
        return (
            device,
            "" if digest == device.digest else f"drawn as '{device.name}'; it was recorded with another device",
        )
    if text := DeviceText.from_note(note):
        try:
            return parse(text.own, note.get("name", "of the recording"), bases=text.bases), ""
        except HaptorbError as cause:
            if note.get("name", "") not in catalogue():
                raise InputError(
                    f"{path}: this version of haptorb cannot read its device: {cause}; name one with --as"
                ) from cause
            trouble = f"device '{note['name']}' is drawn as in this version, not as in the recording: {cause}"
            return load(note["name"]), trouble
    # The file of a trip says no device; its name begins with the device's.
    known = sorted(catalogue(), key=len, reverse=True)
    for one in (note.get("name", ""), *(one for one in known if path.name.startswith(f"{one}-"))):
        if one in known:
            return load(one), f"the recording does not describe its device: '{one}' is assumed"
    raise InputError(f"{path} does not state its device: name one with --as")
