"""Every part that a kind's record names is there, and nothing else in `src` asks for the class of a device."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest

from haptorb.devices.base import DeviceKind, kind_names, kind_of_name, load_part
from haptorb.devices.electromagnet import electromagnet
from haptorb.devices.loader import load
from haptorb.devices.motor import motor
from haptorb.errors import InputError

KINDS = [kind_of_name(name) for name in kind_names()]
PARTS = [
    field.name for field in fields(DeviceKind) if field.name not in ("name", "title", "world", "modes", "contacts")
]


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_every_part_is_where_the_record_says(kind: DeviceKind, part: str) -> None:
    found = kind.part(part)
    assert (found is None) == (getattr(kind, part) is None)
    assert found is None or callable(found)


def test_a_device_names_its_kind() -> None:
    assert load("omni").kind is kind_of_name("spherical-electromagnet")
    assert load("pmsm").kind is kind_of_name("spherical-motor")
    assert load("pmsm").kind.part("linkage")(load("pmsm"), None).modes == load("pmsm").kind.modes
    assert load("omni").kind.part("linkage")(load("omni"), None).modes == load("omni").kind.modes
    assert load_part(len) is len


def test_a_program_for_one_kind_says_so() -> None:
    with pytest.raises(InputError, match="'pmsm' is a spherical motor; `haptorb calibrate` works for spherical elec"):
        electromagnet(load("pmsm"), "`haptorb calibrate`")
    with pytest.raises(InputError, match=r"'omni' is a spherical electromagnet; .* works for spherical motors"):
        motor("omni")


def test_nothing_else_asks_for_the_class_of_a_device(root: Path) -> None:
    asks = re.compile(r"(?:isinstance|issubclass)\([^)]*Spherical|\bcase Spherical|type\(device\)")
    found = [
        f"{path.relative_to(root)}: {line.strip()}"
        for path in sorted((root / "src").rglob("*.py"))
        for line in path.read_text(encoding="utf-8").splitlines()
        if asks.search(line)
    ]
    assert found == []
