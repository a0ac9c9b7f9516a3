"""`haptorb run --serve` as users start it, with the simulated Omni, on free ports; and its report at the end."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import threading
from types import TracebackType
from typing import Any, Self

from oracles.fork_server import get_fork_server


class ServedRun:
    """A run with `servers`, each KIND or KIND:WHERE; `addresses` says where each kind is found."""

    def __init__(self, *servers: str, world: str | None = None) -> None:
        options = [word for one in servers for word in ("--serve", one)]
        self._process = get_fork_server().start_haptorb(
            *("run", "omni", "--headless", "--json", *options, *(["--world", world] if world else [])),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.addresses: dict[str, str] = {}
        self.report: dict[str, Any] = {}
        assert self._process.stderr is not None
        self._lines: list[str] = []
        kinds = {one.partition(":")[0] for one in servers}
        while kinds - set(self.addresses):
            line = self._process.stderr.readline()
            assert line, f"the run ended: {''.join(self._lines)}"
            self._lines.append(line)
            if (found := re.match(r"(haply|osc|lsl|foxglove|native): (.*)", line)) is not None:
                self.addresses[found[1]] = found[2].strip()
        self._reader = threading.Thread(target=self._lines.extend, args=(self._process.stderr,), daemon=True)
        self._reader.start()

    @property
    def alive(self) -> bool:
        """Whether it runs; `end` and a failure end it."""
        return self._process.poll() is None

    def port(self, kind: str) -> int:
        """The first port of a server."""
        return int(re.findall(r":(\d+)", self.addresses[kind])[0])

    def server(self, kind: str) -> dict[str, Any]:
        """What a server counted, after the end."""
        return next(one for one in self.report["servers"] if one["server"] == kind)

    def end(self) -> dict[str, Any]:
        """End it as a terminal does; its report."""
        assert self.alive, f"the run had ended: {self._read_lines()}"
        self._process.send_signal(signal.SIGTERM)
        assert self._process.stdout is not None
        out = self._process.stdout.read()
        self._process.wait(60)
        lines = out.splitlines()
        assert lines, f"the run told no report: {self._read_lines()}"
        self.report = json.loads(lines[-1])
        return self.report

    def explain(self) -> str:
        """After a failure: how it ended by itself, or its trips and what it said. It is over then."""
        if self.alive:
            trips = self.end()["trips"]
            return f"the run was alive, its trips: {trips}, its servers: {self.report['servers']}; {self._read_lines()}"
        return f"the run had ended with code {self._process.returncode}: {self._read_lines()}"

    def _read_lines(self) -> str:
        self._process.wait(60)
        self._reader.join(5)
        return "".join(self._lines)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self.alive:
            self._process.kill()
            self._process.wait()
        self._reader.join(5)
        for stream in (self._process.stdout, self._process.stderr):
            assert stream is not None
            stream.close()
