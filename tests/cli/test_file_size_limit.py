"""A file size limit of the shell (`ulimit -f`) is named as the cause of any failed write."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import pytest

from oracles.made_recording import make_recording


@pytest.mark.parametrize(
    ("limit_kib", "words"),
    [
        # the plan of the servo's process
        pytest.param(4, "run omni --headless --duration 0.1", marks=pytest.mark.slow),
        (300, "run omni --headless --duration 0.1"),  # shared memory
        (8, "export run.mcap --to csv -o table.csv"),
        (1, "study new study.toml"),
    ],
)
def test_the_limit_is_named(limit_kib: int, words: str, tmp_path: Path) -> None:
    if words.startswith("export"):
        make_recording(tmp_path / "run.mcap", 0.3)

    def set_limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1024 * limit_kib, 1024 * limit_kib))

    done = subprocess.run(
        [sys.executable, "-P", "-m", "haptorb", *words.split()], cwd=tmp_path, capture_output=True, text=True,
        check=False, preexec_fn=set_limit, timeout=120,
    )  # fmt: skip
    said = " ".join(done.stderr.split())
    assert done.returncode == 2, said
    assert f"larger than {limit_kib} KiB in this shell (ulimit -f)" in said
    assert "Traceback" not in said
