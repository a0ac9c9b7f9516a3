"""`haptorb run --host` and `feel --host`: the page that other computers reach lets in who knows its token, and nobody
else."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

import haptorb_study.feel

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
