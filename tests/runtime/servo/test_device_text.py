"""The device file that a recording carries: of this very device, whatever lies about."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from haptorb import devices
from haptorb.devices.loader import load, parse
from haptorb.runtime.servo.device_text import text_of

OMNI = (Path(devices.__file__).parent / "catalogue" / "omni.toml").read_text(encoding="utf-8")


def test_of_a_file_and_of_the_catalogue(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text("# mine\n" + OMNI, encoding="utf-8")
    assert text_of(load("omni"), "omni") == text_of(load("omni")) == OMNI
    assert text_of(load(mine), mine) == text_of(load(str(mine)), str(mine)) == "# mine\n" + OMNI
    assert text_of(parse("# nobody's\n" + OMNI, "here"), mine) == ""


def test_what_is_called_as_the_device_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A port of that name, as `hardware emulate --port omni` leaves it: reading it would be waiting for ever.
    monkeypatch.chdir(tmp_path)
    os.mkfifo("omni")
    other = parse("# nobody's\n" + OMNI, "here")
    assert text_of(other, "omni") == ""
    Path("omni").unlink()
    Path("omni").mkdir()
    assert text_of(other, "omni") == ""
