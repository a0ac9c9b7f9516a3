"""`haptorb run --serve` as people start it, with the simulated Omni, on free ports; and its report at the end."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from types import TracebackType
from typing import Any, Self


class ServedRun:
    """A run with `servers`, each KIND or KIND:WHERE; `addresses` says where each kind is found."""

    def __init__(self, *servers: str, world: str | None = None) -> None:
        options = [word for one in servers for word in ("--serve", one)]
        command = "from haptorb.apps.cli import main; main()"
        self._process = subprocess.Popen(
            [sys.executable, "-c", command, "run", "omni", "--headless", "--json", *options]
            + (["--world", world] if world else []),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.addresses: dict[str, str] = {}
        self.report: dict[str, Any] = {}
        assert self._process.stderr is not None
        lines = []
        kinds = {one.partition(":")[0] for one in servers}
        while kinds - set(self.addresses):
            line = self._process.stderr.readline()
            assert line, f"the run ended: {''.join(lines)}"
            lines.append(line)
            if (found := re.match(r"(haply|osc|lsl|foxglove): (.*)", line)) is not None:
                self.addresses[found[1]] = found[2].strip()

    def port(self, kind: str) -> int:
        """The first port of a server."""
        return int(re.findall(r":(\d+)", self.addresses[kind])[0])

    def server(self, kind: str) -> dict[str, Any]:
        """What a server counted, after the end."""
        return next(one for one in self.report["servers"] if one["server"] == kind)

    def end(self) -> dict[str, Any]:
        """End it as a terminal does; its report."""
        self._process.send_signal(signal.SIGTERM)
        out, _ = self._process.communicate(timeout=60)
        self.report = json.loads(out.splitlines()[-1])
        return self.report

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.communicate()
