"""Tutorial's study and commands, in order."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.realtime


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_tutorials_commands_run_as_they_stand(root: Path, tmp_path: Path) -> None:
    text = (root / "docs" / "tutorials" / "study.md").read_text(encoding="utf-8")
    (study,) = re.findall(r"^```toml\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)
    (tmp_path / "places.toml").write_text(study, encoding="utf-8")
    commands = [
        line for block in re.findall(r"^```sh\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)
        for line in block.splitlines()
    ]  # fmt: skip
    assert len(commands) == 6
    said = {}
    for command in commands:
        words = shlex.split(command)
        assert words[:2] == ["haptorb", "study"]
        if "study.db" in words:  # there, a person sat it
            words = [word.replace("study.db", "rehearsal.db") for word in words]
        program = [sys.executable, "-c", "import sys; from haptorb.cli import main; sys.exit(main())", *words[1:]]
        ran = subprocess.run(
            program, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120, env={**os.environ},
        )  # fmt: skip
        assert ran.returncode == 0, (command, ran.stderr)
        said[words[2]] = ran.stdout + ran.stderr
    assert "min" in said["check"]
    assert "SIMULATED" in said["simulate"]
    assert "participants (95 %" in said["power"]
    report = (tmp_path / "rehearsal" / "report.html").read_text(encoding="utf-8")
    assert "SIMULATED" in report
    header, *rows = (tmp_path / "trials.csv").read_text(encoding="utf-8").splitlines()
    assert header.startswith("participant,simulated,simulated_device,pilot,session,trial")
    assert len(rows) == 6 * 17
    assert (tmp_path / "trials.json").is_file()
