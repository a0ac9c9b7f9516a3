"""What that service says of its devices beside their state: ids, config, and what this device has of all that."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from haptorb.apps.serve.haply.space import Space
from haptorb.devices.device import Device
from haptorb.errors import InputError
from haptorb.version import __version__

__all__ = ["DeviceIds", "Settings"]


@dataclass(frozen=True)
class DeviceIds:
    """The ids under which clients know the tool and its grip: hexadecimal digits that stay the same for a device."""

    device: str
    grip: str
    unique: str

    @classmethod
    def of(cls, device: Device) -> DeviceIds:
        """From the digest of `device`'s file."""
        digits = device.digest.upper()
        return cls(digits[:4], digits[4:8], str(uuid.uuid5(uuid.NAMESPACE_URL, f"haptorb:{device.digest}")))

    def is_meant(self, given: object) -> bool:
        """Whether a client that says this id may mean the tool: its id, also as the number that it writes, or none, as
        from one that does not know it yet."""
        if given is None or given in ("", "*", 0, "0"):
            return True
        if isinstance(given, str):
            return given.upper().removeprefix("0X").rjust(len(self.device), "0") == self.device
        return isinstance(given, int) and given == int(self.device, 16)


@dataclass(frozen=True)
class Settings:
    """What clients may set of the device beside its space. Handedness, damping and gate are kept and told; they change
    no force: the guard and the passivity control are this device's own. Of `navigation` nothing is kept: the space is
    small."""

    handedness: str = "right"
    damping: Mapping[str, Any] = field(default_factory=lambda: {"scalar": 0.0})
    gate: float = 1.0

    def configure(self, found: Mapping[str, Any]) -> Settings:
        """With what `found` sets. Raises InputError for what cannot be, and for what this device does not have."""
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
            settings = replace(settings, gate=_share(both["force_gate"], "gain", "force_gate"))
        for name in ("gravity_compensation", "torque_scaling", "home_return"):
            wanted = found.get(name)
            if wanted is True or (isinstance(wanted, Mapping) and wanted.get("enabled") is True):
                raise InputError(
                    f"this device has no {name}: a spherical electromagnet has no arm that it could act on"
                )
        return settings

    def as_json(self, identity: DeviceIds, space: Space) -> dict[str, Any]:
        """The `config` of the device for a client that sees it through `space`, as an inventory has it."""
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
        """The config `name` as a client writes it to set it: that service wraps transforms there, and names of presets,
        which its inventory has plain."""
        known = self.as_json(identity, space)
        found = known["filters"].get(name, known.get(name))
        if name in ("mount", "transform", "workspace"):
            return {"transform": found}
        return dict(found) if isinstance(found, Mapping) else {name: found}


def _share(found: object, name: str, what: str) -> float:
    number = found.get(name) if isinstance(found, Mapping) else found
    if isinstance(number, bool) or not isinstance(number, int | float) or not 0.0 <= number <= 1.0:
        raise InputError(f"{what} is a number from 0 to 1, or an object with {name}")
    return float(number)


def _read_damping(found: object) -> dict[str, Any]:
    """A scalar, a vector of shares along the axes, or both."""
    vector = found.get("vector") if isinstance(found, Mapping) else None
    if not isinstance(vector, Mapping):
        return {"scalar": _share(found, "scalar", "damping")}
    scalar = {"scalar": _share(found, "scalar", "damping")} if isinstance(found, Mapping) and "scalar" in found else {}
    return {**scalar, "vector": {axis: _share(vector.get(axis, 0.0), "", f"damping along {axis}") for axis in "xyz"}}
