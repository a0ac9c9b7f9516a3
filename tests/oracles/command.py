"""Runs one `haptorb` command as typed."""

from __future__ import annotations

import pytest

from haptorb.cli import main

__all__ = ["run_command"]


def run_command(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Exit code, standard output and error; never a traceback."""
    try:
        code = main(list(words))
    except SystemExit as end:
        code = int(end.code or 0)
    out, err = capsys.readouterr()
    assert "Traceback" not in out + err
    return code, out, err
