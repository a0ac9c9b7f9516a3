"""`haptorb keys`: keys of every kind of file in the terminal."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from haptorb.cli.keys import FILES, FileKeys, KeySection
from haptorb.devices.loader import load
from haptorb.devices.registry import REGISTERED, kind_of_name
from haptorb.devices.schema import list_keys
from haptorb.errors import HaptorbError
from haptorb.runtime.trackers.formats import MappingFile
from oracles.command import run_command

pytestmark = pytest.mark.usefixtures("narrow")


@pytest.fixture
def narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")


@pytest.mark.parametrize(
    ("file", "known"),
    [("device", "coils.heat.ambient"), ("study", "levels.reference"), ("design", "objectives.NAME.sense"),
     ("feel", "design.NAME.width"), ("mapping", "messages.values")],
)  # fmt: skip
def test_all_keys_of_a_file_fit_a_terminal(file: str, known: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, said, _ = run_command(capsys, "keys", file)
    assert code == 0
    assert known in said
    assert max(map(len, said.splitlines())) <= 80


def test_a_word_selects_by_name_or_meaning(capsys: pytest.CaptureFixture[str]) -> None:
    found = json.loads(run_command(capsys, "keys", "device", "Ambient", "--json")[1])
    assert {one["key"] for one in found} >= {"coils.heat.ambient"}
    assert all("ambient" in (one["key"] + one["meaning"]).casefold() for one in found)
    assert all("degC" in one["unit"] for one in found if one["key"] == "coils.heat.ambient")


def test_a_word_without_a_key_and_an_unknown_file_are_one_message(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, said = run_command(capsys, "keys", "study", "flywheel")
    assert (code, "flywheel" in said) == (2, True)
    code, _, said = run_command(capsys, "keys", "devise")
    assert (code, "did you mean 'device'" in said) == (2, True)


def test_the_list_is_that_of_the_reader(
    capsys: pytest.CaptureFixture[str], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Each required key that the program lists is one without which it refuses the file."""
    text = run_command(capsys, "devices", "omni")[1]
    found = json.loads(run_command(capsys, "keys", "device", "coils.heat.", "--json")[1])
    listed = {
        one["key"].rpartition(".")[2]
        for one in found
        if one["default"] == "required" and one["section"] == 'kind = "spherical-electromagnet"'
    }
    assert len(listed) >= 7
    path = tmp_path_factory.mktemp("device") / "mine.toml"
    for key in sorted(listed):
        lines = [line for line in text.splitlines() if not line.strip().startswith(f"{key} ")]
        path.write_text("\n".join(lines), encoding="utf-8")
        assert len(lines) < len(text.splitlines()), key
        with pytest.raises(HaptorbError, match=key):
            load(path)


def test_without_a_name_the_kinds_of_file_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    said = run_command(capsys, "keys")[1]
    assert sorted(line.split()[0] for line in said.splitlines()) == ["design", "device", "feel", "mapping", "study"]


def test_what_another_package_adds_is_listed_and_a_kind_made_in_python_hides_nothing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = run_command(capsys, "keys", "device")[1]
    monkeypatch.setitem(REGISTERED, "rail", replace(kind_of_name("coil-array"), name="rail"))
    assert run_command(capsys, "keys", "device") == (0, before, "")
    plugged = FileKeys("a rail: haptorb rail FILE", lambda: [KeySection("", tuple(list_keys(MappingFile)))])
    monkeypatch.setitem(FILES, "rail", plugged)
    assert "haptorb rail FILE" in run_command(capsys, "keys")[1]
    assert "messages.values" in run_command(capsys, "keys", "rail")[1]
