"""`haptorb feel`: designs presented in sequence, rated, stored, compared."""

import json
from pathlib import Path

import pytest

import haptorb_study.feel
from oracles.command import run_command

EXAMPLE = Path(haptorb_study.feel.__file__).parent / "example.toml"


@pytest.mark.realtime
def test_one_design_is_felt_rated_and_kept(capsys, tmp_path):
    folder = tmp_path / "session"
    plot = tmp_path / "comparison.png"
    code, out, err = run_command(
        capsys, "feel", str(EXAMPLE), "--headless", "--seconds", "3", "--only", "firm", "--rate", "firm=6",
        "--choose", "firm", "--session", str(folder), "--plot", str(plot), "--json", "--person", "P1",
    )  # fmt: skip
    assert code == 0, err
    table = json.loads(out)
    assert table["firm"]["score"] == 6
    assert table["firm"]["chosen"]
    assert table["plain"]["score"] is None
    assert plot.stat().st_size > 5000
    rows = (folder / "traces" / "firm-0001.csv").read_text().splitlines()
    pulled = [float(row.split(",")[1]) for row in rows[1:]]
    assert max(pulled) > 1e-3  # the guided hand has begun to pull
    assert json.loads((folder / "ratings.jsonl").read_text().splitlines()[0])["person"] == "P1"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["/no/such/file.toml"], "cannot be read"),
        ([str(EXAMPLE), "--only", "fim"], "unknown design 'fim'"),
        ([str(EXAMPLE), "--rate", "firm"], "NAME=SCORE"),
        ([str(EXAMPLE), "--rate", "firm=9"], "from 1 to 7"),
        ([str(EXAMPLE), "--rate", "fim=3"], "unknown design 'fim'"),
        ([str(EXAMPLE), "--choose", "fim"], "unknown design 'fim'"),
        ([str(EXAMPLE), "--duration", "-1"], "--duration"),
        ([str(EXAMPLE), "--seconds", "-1"], "--duration"),
        ([str(EXAMPLE), "--plot", "a.gif"], "--plot"),
        ([str(EXAMPLE), "--plot", "/no/such/folder/a.png"], "--plot"),
    ],
)
def test_a_mistake_is_one_message(capsys, tmp_path, words, said):
    code, out, err = run_command(capsys, "feel", *words, "--headless", "--session", str(tmp_path / "s"))
    assert code == 2
    assert said in err
    assert not out
    assert not (tmp_path / "s").exists()


def test_a_device_without_modes_cannot_feel_designs(capsys, tmp_path):
    code, _, err = run_command(
        capsys,
        "feel",
        str(EXAMPLE),
        "--device",
        "omni",
        "--headless",
        "--session",
        str(tmp_path / "s"),
        "--only",
        "firm",
    )
    assert code == 2
    assert "works for spherical motors" in err
