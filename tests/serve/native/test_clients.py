"""Published programs, unmodified: the libraries that they load by name are those of haptorb."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from serve.served_run import ServedRun

pytestmark = [pytest.mark.realtime]


def run_client(package: str, libraries: Path, run: ServedRun, tmp_path: Path, source: str) -> dict[str, Any]:
    """What a program prints last, as JSON; it has `package` from PyPI and finds libraries as that does."""
    if find_spec(package) is None:
        pytest.skip(f"{package} is not installed: it needs Python below 3.13")
    sdk = tmp_path / "sdk/lib/release"
    sdk.mkdir(parents=True)
    (sdk / f"lin-{os.uname().machine}-gcc").symlink_to(libraries)
    environment = {
        **os.environ, "FDSDK": str(tmp_path / "sdk"), "LD_LIBRARY_PATH": str(libraries),
        "HAPTORB_RUN": run.addresses["native"],
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", textwrap.dedent(source)], env=environment, capture_output=True,
        text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{done.stdout}{done.stderr}{run.explain()}"
    return dict(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.slow
def test_forcedimension_core(libraries: Path, tmp_path: Path) -> None:
    """Open, 4 kHz of poses, a sphere below the tool and a wall beside it, buttons, close."""
    source = """
        import json, time
        from forcedimension_core import dhd, drd
        import forcedimension_core.dhd.expert as expert

        found = {"count": dhd.getDeviceCount(), "open": dhd.open(), "name": dhd.getSystemName(),
                 "type": int(dhd.getSystemType()), "time_guard": expert.setTimeGuard(0), "on": dhd.enableForce(True)}
        p, v, f, R = [0.0] * 3, [0.0] * 3, [0.0] * 3, [[0.0] * 3 for _ in range(3)]
        assert dhd.getPosition(p) == 0
        found["place"] = list(p)
        centre, radius, stiffness = [p[0], p[1], p[2] - 0.008], 0.01, 200.0
        wall = p[0] + 0.001
        begin, polls, worst, pushes = time.monotonic(), 0, 0, []
        while (now := time.monotonic() - begin) < 1.0:
            worst = max(worst, abs(dhd.getPosition(p)), abs(dhd.getLinearVelocity(v)), abs(dhd.getOrientationFrame(R)))
            depth = radius - sum((a - b) ** 2 for a, b in zip(p, centre)) ** 0.5
            out = [(a - b) / (radius - depth) for a, b in zip(p, centre)]
            force = [max(depth, 0.0) * stiffness * one for one in out]
            force[0] += max(wall - p[0], 0.0) * stiffness
            answer = dhd.setForce(force)
            worst = max(worst, abs(answer))
            polls += 1
            dhd.getForce(f)
            if now > 0.5:
                pushes.append(max(abs(a - b) for a, b in zip(f, force)))
            time.sleep(max(0.0, begin + polls / 4000.0 - time.monotonic()))
        pushes.sort()
        found |= {"rate": polls / 1.0, "worst": worst, "force": sum(one * one for one in f) ** 0.5,
                  "difference": pushes[len(pushes) // 2], "buttons": dhd.getButtonMask(),
                  "frequency": dhd.getComFreq(), "status": drd.isRunning(), "close": dhd.close()}
        print(json.dumps(found))
    """
    with ServedRun("native") as run:
        found = run_client("forcedimension_core", libraries, run, tmp_path, source)
        run.end()
    assert (found["count"], found["open"], found["on"], found["close"], found["time_guard"]) == (1, 0, 0, 0, 0)
    assert (found["name"], found["type"]) == ("haptorb omni", 34)
    assert (found["worst"], found["buttons"], found["status"]) == (0, 0, False)
    assert found["place"] == pytest.approx([0.0, 0.0, 0.002], abs=5e-4), "without a console a tool is held at rest"
    assert found["rate"] > 50.0  # 4 kHz where a processor is free
    assert found["force"] > 0.1, "the sphere pushes the tool"
    assert found["difference"] < 0.02, "what is rendered follows what is commanded"
    assert run.report["trips"] == []
    assert run.report["peak_force_n"] > 0.1
