"""What that service says of its devices beside their state: ids, config, and what this device has of all that."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from haptorb.apps.serve.haply.space import Space
from haptorb.devices.device import Device
from haptorb.errors import InputError

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
        """Whether a client that says this id may mean the tool: its id, or none, as from one that does not know it
        yet."""
        return given is None or given in ("", "*", 0, "0") or (isinstance(given, str) and given.upper() == self.device)


@dataclass(frozen=True)
class Settings:
    """What clients may set of the device beside its space. Handedness, damping and gate are stored and reported; they
    change no force: the guard and the passivity control are this device's own."""

    handedness: str = "right"
    damping: float = 0.0
    gate: float = 1.0
    navigation: Mapping[str, Any] = field(default_factory=dict)

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
            settings = replace(settings, damping=_share(both["damping"], "scalar", "damping"))
        if "force_gate" in both:
            settings = replace(settings, gate=_share(both["force_gate"], "gain", "force_gate"))
        if isinstance(found.get("navigation"), Mapping):
            settings = replace(settings, navigation={})  # this device's space is small: nothing to navigate with
        for name in ("gravity_compensation", "torque_scaling", "home_return"):
            wanted = found.get(name)
            if wanted is True or (isinstance(wanted, Mapping) and wanted.get("enabled") is True):
                raise InputError(
                    f"this device has no {name}: a spherical electromagnet has no arm that it could act on"
                )
        return settings

    def as_json(self, identity: DeviceIds, space: Space) -> dict[str, Any]:
        """The `config` of the device for a client that sees it through `space`."""
        return {
            "type": "inverse3",
            "handedness": self.handedness,
            "port": "haptorb",
            "device_info": {
                "major_version": 3,
                "minor_version": 5,
                "id": int(identity.device, 16),
                "device_type": 0,
                "uuid": identity.unique,
            },
            "gravity_compensation": {"enabled": False, "scaling_factor": 0.0},
            "torque_scaling": {"enabled": False},
            "home_return": {"enabled": False},
            "preset": {"preset": space.preset},
            "basis": {"permutation": space.basis.permutation},
            "mount": {"transform": space.mount.as_json()},
            "workspace": {"transform": space.workspace.as_json()},
            "filters": {"force_gate": {"gain": self.gate}, "damping": {"scalar": self.damping}},
        }


def _share(found: object, name: str, what: str) -> float:
    number = found.get(name) if isinstance(found, Mapping) else found
    if isinstance(number, bool) or not isinstance(number, int | float) or not 0.0 <= number <= 1.0:
        raise InputError(f"{what} is a number from 0 to 1, or an object with {name}")
    return float(number)
