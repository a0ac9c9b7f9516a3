"""What `haptorb study` refuses before anybody sits down: said politely, and nothing is left lying about."""

from __future__ import annotations

from pathlib import Path

import pytest

from haptorb.apps.cli import main

GOOD = 'name = "good"\n[set_points]\npoints = [{ number = 1, theta_deg = 0 }]\n[trials]\nrepetitions = 1\n'


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--driver", "nonsense"), "unknown driver"),
        (("--tracker", "nobody"), "unknown tracker"),
        (("--lsl", "moon"), "'computer' or 'network'"),
        (("--port", "70000"), "port must be"),
        (("--terminal",), "--participant"),
        (("--terminal", "-p", "P01", "--lsl", "computer"), "leave --terminal away"),
        (("-p", "Anna"), "never a name"),
        (("--db", "postgresql://study:very-secret@127.0.0.1:9/x"), "nothing was started"),
        (("--db", "no-such-folder/s.db"), "cannot be opened"),
    ],
)
def test_a_run_that_cannot_be(
    words: tuple[str, ...],
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text(GOOD)
    try:
        code = main(["study", "run", "s.toml", *words])
    except SystemExit as end:
        code = int(end.code or 0)
    said = capsys.readouterr()
    assert code == 2
    assert told in said.out + said.err
    assert "Traceback" not in said.out + said.err
    assert "very-secret" not in said.out + said.err
    made = {path.name for path in tmp_path.iterdir()} - {"s.toml"}
    assert not {name for name in made if not name.startswith("study.db")}
    if "--port" not in words:  # a port is looked at last, when the database is there
        assert not made
