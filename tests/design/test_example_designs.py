"""The supplied design files can be read, and lead to a device file."""

from __future__ import annotations

from pathlib import Path

import pytest

from haptorb.devices.loader import load
from haptorb_design.design_file import load_design
from haptorb_design.problem import write_device_text
from haptorb_design.sampling import make_values

FOLDER = Path(__file__).parents[2] / "examples" / "design"
BASES = {"omni-computed", "omni-rewound"}  # devices
FILES = sorted(path for path in FOLDER.glob("*.toml") if path.stem not in BASES)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_it_is_read_and_writes_a_device_file(path: Path) -> None:
    design = load_design(path)
    assert design.name == path.stem
    values = make_values(design, [0.5] * len(design.parameters))
    assert f'based_on = "{design.base}"' in write_device_text(design, values, "found")


@pytest.mark.parametrize("name", sorted(BASES))
def test_the_base_devices_beside_them_can_be_built(name: str) -> None:
    assert load(FOLDER / f"{name}.toml").name == name
