"""The design files that come with haptorb can be read, and lead to a device file."""

from __future__ import annotations

from pathlib import Path

import pytest

from haptorb_design.design_file import load_design
from haptorb_design.problem import write_device_text
from haptorb_design.sampling import make_values

FILES = sorted((Path(__file__).parents[2] / "examples" / "design").glob("*.toml"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_it_is_read_and_writes_a_device_file(path: Path) -> None:
    design = load_design(path)
    assert design.name == path.stem
    values = make_values(design, [0.5] * len(design.parameters))
    assert f'based_on = "{design.base}"' in write_device_text(design, values, "found")
