"""`--host` of `haptorb run`, `feel`, `view` and `design show`: other computers need the token of the page."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

import haptorb_study.feel
from haptorb.web.server import PageAddress
from haptorb.web.view import Viewer
from haptorb_design.chooser import Chooser
from haptorb_design.results_table import ResultsTable
from haptorb_design.store import Results, Run
from oracles.designs.made_designs import make_design, make_evaluations
from oracles.made_recording import make_recording

pytestmark = pytest.mark.realtime


DESIGNS = Path(haptorb_study.feel.__file__).parent / "example.toml"


@pytest.mark.slow
@pytest.mark.parametrize("words", [("run", "omni", "--duration", "20"), ("feel", str(DESIGNS))], ids=("run", "feel"))
def test_only_who_knows_the_token_gets_in_from_another_address(words: tuple[str, ...], tmp_path: Path) -> None:
    """127.0.0.2 is an address of this computer at which the console does not listen unless it is asked to."""
    command = [sys.executable, "-P", "-m", "haptorb", *words, "--host", "0.0.0.0", "--port", "0"]
    command += ["--session", str(tmp_path / "session")] if words[0] == "feel" else []
    program = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        assert program.stdout is not None
        said = ""
        while (found := re.search(r"http://[^/\s]+:(\d+)/#(\S+)", said)) is None:
            line = program.stdout.readline()
            assert line, said
            said += line
        assert "other computers" in " ".join(said.lower().split())
        port, token = found.groups()
        place = f"ws://127.0.0.2:{port}/ws"
        for shown in ([], ["haptorb", "token." + "x" * len(token)]):
            with pytest.raises(InvalidStatus) as refused:
                connect(place, subprotocols=[Subprotocol(one) for one in shown] or None, proxy=None).close()
            assert refused.value.response.status_code == 403
        right = [Subprotocol("haptorb"), Subprotocol(f"token.{token}")]
        with pytest.raises(InvalidStatus) as refused:
            connect(place, subprotocols=right, origin="http://evil.example", proxy=None).close()  # type: ignore[arg-type]
        assert refused.value.response.status_code == 403
        with connect(place, subprotocols=right, proxy=None) as page:
            assert page.recv(timeout=10)
    finally:
        program.terminate()
        program.communicate(timeout=30)


@contextmanager
def serve_recording(folder: Path) -> Iterator[tuple[int, str, str]]:
    make_recording(folder / "run.mcap", 0.5)
    with Viewer([folder / "run.mcap"], 0, force_map=_paint_nothing, where=PageAddress("0.0.0.0")) as viewer:
        ready = threading.Event()
        serving = threading.Thread(target=lambda: viewer.serve(ready=ready.set))
        serving.start()
        assert ready.wait(30)
        yield viewer.port, viewer.token, "api/view"
        viewer.close()
        serving.join(10)


def _paint_nothing(name: str, values: Any, model: str, points: Any) -> Any:
    return np.zeros(len(points)), np.zeros(len(points), dtype=bool)


@contextmanager
def serve_designs(folder: Path) -> Iterator[tuple[int, str, str]]:
    table = ResultsTable.of(Results(make_design(), (Run(1, "sobol", 1, {}, "", "", tuple(make_evaluations(20))),)))
    with Chooser(table, 0, where=PageAddress("0.0.0.0")) as chooser:
        serving = threading.Thread(target=chooser.serve)
        serving.start()
        yield chooser.port, chooser.token, "api/designs"
        chooser.close()
        serving.join(10)


@pytest.mark.parametrize("serve", [serve_recording, serve_designs])
def test_recordings_and_designs_from_another_address(
    serve: Callable[[Path], AbstractContextManager[tuple[int, str, str]]], tmp_path: Path
) -> None:
    with serve(tmp_path) as (port, token, path), httpx.Client(base_url=f"http://127.0.0.2:{port}/") as page:
        right = {"authorization": f"Bearer {token}"}
        assert page.get(path, headers=right).status_code == 200
        for wrong in ({}, {"authorization": "Bearer " + "x" * len(token)}, right | {"host": "evil.example"},
                      right | {"origin": "http://evil.example"}):  # fmt: skip
            assert page.get(path, headers=wrong).status_code == 403
