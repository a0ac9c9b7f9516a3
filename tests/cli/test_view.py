"""`haptorb view`: output, and errors where nothing can be played."""

from __future__ import annotations

import json

import pytest

from haptorb.cli import main
from oracles.made_recording import make_recording


def test_prints_the_address_and_what_is_missing(tmp_path, capsys):
    path = tmp_path / "cut.mcap"
    make_recording(path, 0.5, end=False)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(SystemExit, match="0"):
        main(["view", f"{path}#t=3.1,3.2", "--port", "0", "--duration", "0.01", "--json"])
    told = json.loads(capsys.readouterr().out)
    assert told["url"].startswith("http://127.0.0.1:")
    (one,) = told["recordings"]
    assert one["device"] == "omni"
    assert one["notices"]


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["none.mcap"], "No such file"),
        (["none.mcap#t=2,1"], "FILE#t=FROM,TO"),
        (["none.mcap", "--at", "soon"], "--at"),
        (["none.mcap", "--offset", "1 kg"], "--offset"),
        (["none.mcap", "--duration", "0"], "--duration"),
        (["none.mcap", "--port", "70000"], "port must be"),
    ],
)
def test_a_mistake_is_one_message(words, reason, capsys):
    assert main(["view", *words]) == 2
    error = capsys.readouterr().err
    assert reason in error.replace("\n", " ")
    assert "Traceback" not in error
