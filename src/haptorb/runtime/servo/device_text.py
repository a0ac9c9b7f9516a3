"""The file from which a device was built, for the recording: found by its digest, never assumed."""

from __future__ import annotations

import hashlib
from pathlib import Path

from haptorb import devices
from haptorb.devices.device import Device

__all__ = ["text_of"]

_CATALOGUE = Path(devices.__file__).parent / "catalogue"


def text_of(device: Device, given: object = None) -> str:
    """The text of `device`'s file: the catalogue's, or that of `given` if that is its path; empty if neither fits.

    `given` may be a name; a file of that name may be something else, such as a port or a folder.
    """
    candidates = sorted(_CATALOGUE.glob("*.toml"))
    if isinstance(given, str | Path):
        candidates.append(Path(given))
    for path in candidates:
        if not path.is_file():  # to read a port is to wait for it
            continue
        try:
            content = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            continue
        if hashlib.sha256(content.encode()).hexdigest() == device.digest:
            return content
    return ""
