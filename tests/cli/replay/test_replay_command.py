"""`haptorb replay`: output for people and programs."""

from __future__ import annotations

import json
import re
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptorb import Recording
from haptorb.arrays import Array
from haptorb.cli.program import main
from oracles.recorded_chain import record_chain


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("recordings")

    def plant(rows: Array) -> None:
        rows[120, 30] = np.nextafter(rows[120, 30], 1.0)

    return {
        "same": record_chain(folder / "same.mcap", ticks=200).path,
        "other": record_chain(folder / "other.mcap", ticks=200, change=plant).path,
    }


def call(*words: str) -> int:
    """The exit code of the command."""
    try:
        return main(["replay", *words])
    except SystemExit as end:
        return int(end.code or 0)


def test_the_same_bits_are_a_yes(recordings: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert call(str(recordings["same"])) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "every number of 200 ticks is the same, bit for bit" in text


def test_another_bit_is_a_no_with_its_place(recordings: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert call(str(recordings["other"])) == 1
    out = capsys.readouterr().out
    assert "tick 120" in out
    table = out[out.index("from tick") :].splitlines()
    assert max(map(len, table)) <= 80


def list_paths(value: Any, at: str = "") -> set[str]:
    """Paths of all leaves, as the reference of JSON output writes them."""
    if isinstance(value, dict) and value:
        return {path for key, part in value.items() for path in list_paths(part, f"{at}.{key}" if at else key)}
    if isinstance(value, list) and any(isinstance(part, dict) for part in value):
        return {path for part in value for path in list_paths(part, f"{at}[]")}
    return {at}


def test_json_has_the_keys_of_its_reference(
    recordings: dict[str, Path], capsys: pytest.CaptureFixture[str], root: Path
) -> None:
    assert call(str(recordings["other"]), "--json") == 1
    found = json.loads(capsys.readouterr().out)
    assert found["first"]["tick"] == 120
    assert found["ticks_different"] == 1
    page = (root / "docs" / "reference" / "json-output.md").read_text(encoding="utf-8")
    section = page.split("## haptorb replay\n")[1].split("\n## ")[0]
    rows = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
    keys = [key for cell in rows for key in re.findall(r"`([^`]+)`", cell)]
    patterns = [key.replace("[", "[[]") for key in keys]
    assert [path for path in list_paths(found) if not any(fnmatchcase(path, one) for one in patterns)] == []


def test_another_world_is_written_and_drawn(
    recordings: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, figure = tmp_path / "fluid.mcap", tmp_path / "fluid.svg"
    words = (str(recordings["same"]), "--world", "fluid", "--set", "viscosity=3", "--out", str(out))
    assert call(*words, "--compare", str(figure)) == 0
    assert "another world" in capsys.readouterr().out
    assert len(Recording(out)) == 200
    assert json.loads(Recording(out).worlds[0]["world"])["values"]["viscosity"] == 3.0
    drawn = figure.read_text(encoding="utf-8")  # matplotlib notes every text that it draws
    assert all(f"<!-- coil {name} -->" in drawn for name in "xyz")
    assert call(str(out)) == 0
    capsys.readouterr()
    assert call(*words) == 2
    assert "exists" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--world", "swamp"), "swamp"),
        (("--set", "viscosity=3"), "--set"),
        (("--estimator", "network"), "network"),
        (("--model", "guess"), "guess"),
        (("--rate", "3"), "rate"),
        (("--compare", "picture.doc"), "--compare"),
    ],
)
def test_mistakes_are_told(
    words: tuple[str, str], said: str, recordings: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(str(recordings["same"]), *words) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("content", [b"", b"no recording", b"\x89MCAP0\r\n"])
def test_what_is_no_recording_is_refused(content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "file.mcap"
    file.write_bytes(content)
    assert call(str(file)) == 2
    assert str(file) in capsys.readouterr().err.replace("\n", "")
