"""Units, and the definitions that are cached between two starts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from haptorb.devices import quantity


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of the kept definitions, filled by a first use; the next use is another program's."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    quantity._registry.cache_clear()
    assert quantity.si("2 dyn", "N", "a force") == 2e-5  # a unit that only pint knows
    quantity._registry.cache_clear()
    yield tmp_path / "haptorb" / "units"
    quantity._registry.cache_clear()


def test_definitions_are_kept_and_read_again(kept: Path) -> None:
    before = {file: file.stat().st_mtime_ns for file in kept.rglob("*.pickle")}
    assert before
    assert quantity.si("1 nautical_mile", "m", "a length") == 1852.0
    assert {file: file.stat().st_mtime_ns for file in kept.rglob("*.pickle")} == before


@pytest.mark.parametrize(
    "content", [b"", b"\x80\x04\x95", b"what is this", b"\x80\x04\x8c\x08builtins\x94\x8c\x05nonex\x94\x93."]
)
def test_what_a_killed_process_left_is_thrown_away(kept: Path, content: bytes) -> None:
    for file in kept.rglob("*.pickle"):
        file.write_bytes(content)
    assert quantity.si("1 nautical_mile", "m", "a length") == 1852.0
    quantity._registry.cache_clear()
    assert quantity.si("5 atm", "Pa", "a pressure") == 506625.0


def test_a_folder_that_cannot_be_made_costs_time_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    quantity._registry.cache_clear()
    assert quantity.si("1 nautical_mile", "m", "a length") == 1852.0
    quantity._registry.cache_clear()
