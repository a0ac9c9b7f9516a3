"""Two servos never use the same core; ended ones hold none."""

from __future__ import annotations

import subprocess
import sys

from haptorb.runtime import linux

FREE = (10_001, 10_002)  #: no computer has them, so no servo that runs beside this test holds them

_TAKES = f"from haptorb.runtime.linux import claim; print(claim({FREE!r}), flush=True); input()"


def test_each_takes_another_core_until_none_is_left(monkeypatch: object) -> None:
    with subprocess.Popen([sys.executable, "-c", _TAKES], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert int(other.stdout.readline()) == FREE[0]
        assert linux.claim(FREE) == FREE[1]
        assert linux.claim(FREE) == -1
        other.kill()
    assert linux.claim(FREE) == FREE[0]
    while linux._held and str(linux._held[-1].getsockname())[-3:-1] in ("01", "02"):
        linux._held.pop().close()
