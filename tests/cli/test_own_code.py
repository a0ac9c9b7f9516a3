"""The user's own code is named before it runs: file and use."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import pytest

from haptorb.cli.own_code import announce_code
from haptorb.cli.world_option import choose_world_option
from haptorb.devices.loader import load
from haptorb.errors import HaptorbError
from haptorb_design.design_file import load_design
from haptorb_study.feel.designs import load_designs
from haptorb_study.study_file import study_of

WORLD = """
import sys
import numpy as np
print("it runs", file=sys.stderr)

def pull(state):
    return np.zeros(6)
"""
DESIGN = """
name = "own"
base = "omni"
[parameters.turns]
places = ["coils.turns"]
low = 400
high = 500
[objectives.mine]
function = "code.py:pull"
unit = "1"
"""
STUDY = """
name = "own"
world = "code.py:pull"
"""
FEEL = """
title = "own"
world = "code.py:pull"
[design.one]
"""


@pytest.mark.parametrize("start", ["world", "design", "study", "feel"])
def test_code_is_named_before_it_runs(
    start: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    (tmp_path / "code.py").write_text(WORLD)
    if start == "world":
        choose_world_option(f"{tmp_path / 'code.py'}:pull", [], load("omni"))
    else:
        (tmp_path / "file.toml").write_text({"design": DESIGN, "study": STUDY, "feel": FEEL}[start])
        with suppress(HaptorbError):  # what the rest of such a short file lacks
            if start == "design":
                load_design(tmp_path / "file.toml", announce_code)
            elif start == "study":
                study_of(STUDY, "study", tmp_path)
            else:
                load_designs(tmp_path / "file.toml")
    said = capsys.readouterr().err
    assert f"Running the code of {tmp_path / 'code.py'} (pull)" in said.replace("\n", " ")
    assert said.index("Running") < said.index("it runs")
