"""All benchmarks in one table with the data of the machine: stored as JSON, printed as text or Markdown."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from datetime import date
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

from rich.console import Console

from haptorb.display import format_beside
from haptorb.errors import InputError, UnknownName
from haptorb.files import parse_json, read_text, replace_file
from haptorb.notebook import NotebookReport
from haptorb.runtime.linux import require_linux
from haptorb.terminal import Column, TextTable, print_table, print_text
from haptorb_bench.contest import spell_time

__all__ = ["BENCHMARKS", "BenchResult", "Metric", "load_result", "run_benchmarks"]

#: name → module beside this one and its function; a benchmark of your own is one line here
BENCHMARKS = {
    "magnetics": ("magnetics", "rows"),
    "estimation": ("estimation", "rows"),
    "allocation": ("allocation", "rows"),
    "tick": ("ticking", "rows"),
    "start": ("starting", "rows"),
    "loop": ("outside", "loop"),
    "console": ("outside", "console"),
    "serial": ("outside", "serial"),
    "recording": ("recording", "rows"),
    "training": ("training", "rows"),
    "study": ("outside", "study"),
}
#: those that measure a running servo
_OF_A_SERVO = ("start", "loop", "console", "serial", "recording")
_SHORT = 45  #: longest note in a short table
_PACKAGES = ("haptorb", "numpy", "numba", "scipy", "magpylib", "cfsem", "daqp")


@dataclass(frozen=True)
class Metric:
    """A measured figure.

    benchmark   which one it belongs to
    what        the quantity, in words
    value       ours, in `unit`; None where it could not be measured, and then `note` says why
    unit        such as "µs" or "1/s"
    peer        the peer that did the same in the same run; empty for none
    peer_value  theirs, in `unit`
    limit       what the project promises, in `unit`; None without a promise
    at_least    the limit is a least, not a most
    note        what must be known to read the figure
    """

    benchmark: str
    what: str
    value: float | None
    unit: str
    peer: str = ""
    peer_value: float | None = None
    limit: float | None = None
    at_least: bool = False
    note: str = ""

    @property
    def ratio(self) -> float | None:
        """How many times better we are: their time over ours, or our rate over theirs; below 1 we are worse.

        >>> Metric("allocation", "one", 2.0, "µs", "DAQP", 9.0).ratio
        4.5
        """
        if self.peer_value is None or not self.value:
            return None
        return self.value / self.peer_value if self.at_least else self.peer_value / self.value

    @property
    def kept(self) -> bool | None:
        """Whether the limit is kept; None without a limit or without a figure.

        >>> Metric("tick", "ticks on time", 0.9995, "1", limit=0.999, at_least=True).kept
        True
        """
        if self.limit is None or self.value is None:
            return None
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {**asdict(self), "ratio": self.ratio, "kept": self.kept}

    @classmethod
    def read(cls, numbers: dict[str, Any]) -> Metric:
        """A row from what `numbers` gave."""
        return cls(**{key: value for key, value in numbers.items() if key not in ("ratio", "kept")})


@dataclass(frozen=True)
class BenchResult(NotebookReport):
    """What one run of `haptorb bench` found.

    machine   processor, cores, load before the run, system, versions
    command   that measured it
    day       of the run, ISO
    rows      all figures, in the order of BENCHMARKS
    """

    machine: dict[str, str]
    command: str
    day: str
    rows: tuple[Metric, ...]

    def _summarize(self) -> str:
        names = ", ".join(dict.fromkeys(row.benchmark for row in self.rows))
        return f"<BenchResult of {self.day}: {len(self.rows)} figures of {names}>"

    def numbers(self) -> dict[str, Any]:
        """Everything as plain JSON types."""
        return {
            "command": self.command,
            "day": self.day,
            "machine": self.machine,
            "rows": [row.numbers() for row in self.rows],
        }

    def store(self, path: Path) -> None:
        """Write the numbers to `path`, whole or not at all."""
        with replace_file(path) as part:
            part.write_text(json.dumps(self.numbers(), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")

    def show(self, console: Console) -> None:
        """Print the table for people."""
        print_text(console, ", ".join(f"{key} {value}" for key, value in self.machine.items()), "dim")
        for name in dict.fromkeys(row.benchmark for row in self.rows):
            columns = (
                Column("quantity", kind="text"), Column("here"), Column("limit"), Column("ratio"),
                Column("against", kind="note"), Column("note", kind="note"),
            )  # fmt: skip
            table = TextTable(columns, f"\n{name}")
            for row in self.rows:
                if row.benchmark == name:
                    what, here, limit, against, there, ratio, note = _cells(row)
                    table.add_row(what, here, limit, ratio, f"{against} {there}".strip(), note)
            print_table(console, table)

    def markdown(self, benchmarks: Iterable[str] = BENCHMARKS, *, short: bool = False) -> str:
        """The table of some benchmarks as Markdown, with command and machine above it.

        `short` leaves out what has neither peer nor limit, and long notes.
        """
        wanted = list(benchmarks)
        lines = [
            f"Measured by `{self.command}` on {self.day}: {self.machine.get('processor', 'unknown')}, "
            f"{self.machine.get('cores', '?')} cores, {self.machine.get('system', '')}, "
            f"load before {self.machine.get('load before', '?')}.",
            "",
            "| | here | limit | against | there | ratio |",
            "| --- | ---: | ---: | --- | ---: | ---: |",
        ]
        for row in self.rows:
            if row.benchmark in wanted and not (short and row.limit is None and not row.peer):
                what, *rest, note = _cells(row)
                label = f"{row.benchmark}: {what}"
                if note and len(note) <= (_SHORT if short else 1000):
                    label += f" ({note})"
                lines.append("| " + " | ".join([label, *rest]) + " |")
        return "\n".join(lines) + "\n"


def run_benchmarks(
    names: Iterable[str], effort: float, command: str, notify: Callable[[str, str], None]
) -> BenchResult:
    """Run the benchmarks `names`, one after the other; `notify(name, what)` is called with what is running.

    `effort` 1 is the full length of each, less is shorter and noisier. Raises UnknownName, InputError, PlatformError.
    """
    chosen = list(names)
    for name in chosen:
        if name not in BENCHMARKS:
            raise UnknownName("benchmark", name, BENCHMARKS)
    live = [name for name in chosen if name in _OF_A_SERVO]
    if live:
        others = " ".join(name for name in BENCHMARKS if name not in _OF_A_SERVO)
        require_linux(f"`haptorb bench {' '.join(live)}`", f"haptorb bench {others}")
    if not 0.0 < effort <= 10.0:
        raise InputError(f"--effort must be above 0 and at most 10; got {effort:g}")
    facts = machine()
    rows: list[Metric] = []
    for name in chosen:
        module, function = BENCHMARKS[name]
        run = getattr(import_module(f"haptorb_bench.{module}"), function)
        rows += run(effort, lambda what, name=name: notify(name, what))
    return BenchResult(facts, command, date.today().isoformat(), tuple(rows))


def load_result(path: Path) -> BenchResult:
    """What `BenchResult.store` wrote. Raises InputError for a file that is none."""
    try:
        numbers = parse_json(read_text(path, "benchmarks", InputError, 4 * 1024 * 1024))
        rows = tuple(Metric.read(row) for row in numbers["rows"])
        return BenchResult(numbers["machine"], numbers["command"], numbers["day"], rows)
    except (InputError, ValueError, KeyError, TypeError) as cause:
        raise InputError(f"{path} holds no benchmarks; `haptorb bench --store {path}` writes them") from cause


def machine() -> dict[str, str]:
    """What the numbers are measured on."""
    cpu = Path("/proc/cpuinfo")
    lines = cpu.read_text(encoding="utf-8").splitlines() if cpu.is_file() else []
    facts = {
        "processor": next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), "unknown"),
        "cores": str(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()),
        "load before": f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown",
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
    }
    for package in _PACKAGES:
        try:
            facts[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return facts


def _cells(row: Metric) -> tuple[str, str, str, str, str, str, str]:
    """What, here, limit, against, there, ratio, note.

    >>> _cells(Metric("loop", "ticks on time", 0.99949, "1", limit=0.9995, at_least=True))[1:3]
    ('0.99949', '≥ 0.9995 (missed)')
    >>> _cells(Metric("start", "warm", 1500.4, "µs", limit=1500.0))[1:3]
    ('1500.4 µs', '≤ 1.50 ms (missed)')
    >>> _cells(Metric("start", "a command", 4.003, "s", limit=4.0))[1:3]
    ('4.003 s', '≤ 4 s (missed)')
    """
    sign = "≥" if row.at_least else "≤"
    limit = "" if row.limit is None else f"{sign} {_figure(row, row.limit)}"
    here = "not measured" if row.value is None else _figure(row, row.value)
    if row.limit is not None and row.value is not None and not row.kept:
        limit += " (missed)"
        if here == _figure(row, row.limit):
            decimals = len(spell_number(row.limit).partition(".")[2])
            here = _spell_unit(row, format_beside(row.value, row.limit, decimals))
    there = "" if row.peer_value is None else _figure(row, row.peer_value)
    ratio = "" if row.ratio is None else f"{spell_number(row.ratio)} ×"
    return row.what, here, limit, row.peer, there, ratio, row.note


def _figure(row: Metric, value: float) -> str:
    if row.unit == "µs" and value >= 1000:
        return spell_time(1e-6 * value)
    return _spell_unit(row, spell_number(value))


def _spell_unit(row: Metric, number: str) -> str:
    return number if row.unit == "1" else f"{number} {row.unit}"


def spell_number(value: float) -> str:
    """Three digits, thousands apart, no exponent where people would not want one.

    >>> [spell_number(x) for x in (12345.6, 0.99953, 0.99998, 21.44, 0.0312)]
    ['12,346', '0.9995', '0.99998', '21.4', '0.0312']
    """
    if abs(value) >= 1000:
        return f"{value:,.0f}"
    if 0.99 < value < 1:
        return format_beside(value, 1.0, 4)
    return f"{value:.3g}"
