"""`haptorb design show`: the chosen design runs on a real servo, and ^C ends everything."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from typing import Any

import pytest

from oracles.designs.made_designs import make_results

pytestmark = pytest.mark.realtime

COMMAND = [sys.executable, "-c", "import sys; from haptorb.cli import main; sys.exit(main())", "design", "show"]


def _ask(url: str, path: str, body: Any = None) -> Any:
    origin, _, token = url.partition("/#")
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(origin + path, data, {"authorization": f"Bearer {token}"})
    with urllib.request.urlopen(request, timeout=60) as answer:
        return json.load(answer)


@pytest.mark.slow
def test_a_chosen_design_runs_with_its_coils_off_until_the_program_is_interrupted(tmp_path: Path) -> None:
    results = make_results(tmp_path / "r.sqlite", 60)
    with subprocess.Popen([*COMMAND, str(results), "--port", "0"], stderr=subprocess.PIPE, text=True) as program:
        try:
            assert program.stderr is not None
            url = next(word for word in program.stderr.readline().split() if word.startswith("http"))
            name = _ask(url, "/api/designs")["names"][0]
            assert _ask(url, "/api/now")["state"] == "none"
            _ask(url, "/api/choose", {"row": 0})
            end = time.monotonic() + 60.0
            while (now := _ask(url, "/api/now"))["state"] == "starting":
                assert time.monotonic() < end
                time.sleep(0.05)
            assert now["state"] == "running", now
            program.send_signal(signal.SIGINT)
            _, said = program.communicate(timeout=60)
        finally:
            program.kill()
    assert program.returncode == 130
    assert f"{name} runs, SIMULATED, with its coils off" in said
    assert "Traceback" not in said
