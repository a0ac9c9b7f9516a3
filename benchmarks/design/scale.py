"""Designs per minute with one process and with more; memory and time to resume a run of 10 000.

    python benchmarks/design/scale.py [examples/design/motor-latitudes.toml] [--designs 200] [--processes 2]
                                      [--at-least 500] [--json]
    python benchmarks/design/scale.py benchmarks/design/omni_scale.toml --designs 1000 --at-least 2000

A sweep of so many designs by one process, then the same by more, as `haptorb design sweep` runs it, into a results
file each; its processes are started and warm before the time begins: the first designs of a process compile nothing,
but import and build the base device. Rejected designs count; "valid" is the number of the others, and
"valid_seconds" the median processor time of one of them. The efficiency is the ratio of the rates, divided by the
number of processes. The exit code is 1 if several processes evaluate fewer valid designs a minute than --at-least, the
efficiency is below 0.85, one valid design takes more than 0.15 s, or what follows takes more than 5 s or 1 GB.

Then an optimiser's run of 10 000 evaluations of a formula is stored in a file, and another process opens the file and
takes the optimiser through all of them. "own" is what the optimiser itself took to make the run.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from statistics import median
from typing import Any

from haptorb_design.design_file import load_design
from haptorb_design.problem import Design, Evaluation, Value
from haptorb_design.sampling import sample, sweep
from haptorb_design.search import Optimiser, optimise
from haptorb_design.store import open_results
from haptorb_design.tally import store_candidates
from haptorb_design.workers import open_processes

MANY = 10_000
EACH, EFFICIENCY, RESUME, MEMORY = 0.15, 0.85, 5.0, 1000.0  #: limits [s], 1, [s], [MB]


def time_sweep(design: Design, count: int, processes: int, folder: str) -> dict[str, float]:
    """Designs per minute, and how many were valid."""
    values = sample(design, "sobol", count + 8 * processes, 1)
    place = Path(folder) / f"{processes}.sqlite"
    with open_results(place, design, "sobol", 1) as writer, open_processes(design, processes) as workers:
        for _ in workers.evaluate(enumerate(values[count:])):
            pass
        begin = time.perf_counter()
        store_candidates(writer, sweep(values[:count], workers.evaluate, {}), design, count)
        seconds = time.perf_counter() - begin
        found = writer.list_known().values()
    valid = sum(one.valid for one in found)
    return {"designs_per_minute": 60.0 * count / seconds, "valid_per_minute": 60.0 * valid / seconds,
            "valid_seconds": median(one.seconds for one in found if one.valid),
            "processor_seconds_each": sum(one.seconds for one in found) / count}  # fmt: skip


def compute_formula(design: Design, jobs: Iterable[tuple[int, Mapping[str, Value]]]) -> Iterator[Evaluation]:
    """A convex objective for each goal of `design`, each best in another corner; no device is built."""
    for number, values in jobs:
        shares = [
            (float(values[one.name]) - one.low) / (one.high - one.low)
            for one in design.parameters
            if not one.choices and one.high > one.low
        ]
        costs = {goal.name: sum((x - 0.3 * k) ** 2 for x in shares) for k, goal in enumerate(design.goals)}
        yield Evaluation(number, values, costs, {})


def fill(path: str, file: str, count: int) -> float:
    """Seconds that an optimiser's own work took in a run of `count` evaluations, which are stored."""
    design = load_design(file)
    begin = time.perf_counter()
    optimiser = Optimiser(design, seed=1)
    found = list(optimise(optimiser, lambda jobs: compute_formula(design, jobs), {}, count))
    own = time.perf_counter() - begin
    with open_results(path, design, "nsga2", 1) as writer:
        writer.add(found)
    return own


def resume(path: str, file: str, count: int) -> tuple[float, float]:
    """Seconds until an optimiser stands behind what is stored, and this process' greatest memory [bytes]."""
    begin = time.perf_counter()
    design = load_design(file)
    with open_results(path, design, "nsga2", 1) as writer:
        known = writer.list_known()
        optimiser = Optimiser(design, seed=1)
        more = list(optimise(optimiser, lambda jobs: compute_formula(design, jobs), known, count))
    assert (len(known), len(more)) == (count, 0)
    return time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024.0


def run_alone(function: Any, *arguments: Any) -> Any:
    """What `function` returns in a process of its own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def measure(file: str, count: int, processes: int) -> dict[str, Any]:
    """All figures."""
    design = load_design(file)
    with tempfile.TemporaryDirectory() as folder:
        one, more = (time_sweep(design, count, many, folder) for many in (1, processes))
        path = str(Path(folder) / "results.sqlite")
        own = run_alone(fill, path, file, MANY)
        seconds, memory = run_alone(resume, path, file, MANY)
    rate = "designs_per_minute"
    return {
        "design": design.name, "designs": count, "one_process": one, f"{processes}_processes": more,
        "efficiency": more[rate] / one[rate] / processes,
        "stored": MANY, "optimiser_own_seconds": own, "resume_seconds": seconds, "memory_megabytes": memory / 1e6,
    }  # fmt: skip


def main() -> int:
    """Measure, print, and say whether the limit holds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", nargs="?", default="examples/design/motor-latitudes.toml")
    parser.add_argument("--designs", type=int, default=200)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--at-least", type=float, default=0.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = measure(options.file, options.designs, options.processes)
    if options.json:
        print(json.dumps(found))
    else:
        for name, value in found.items():
            print(f"{name:24} {value:.4g}" if isinstance(value, float) else f"{name:24} {value}")
    more = found[f"{options.processes}_processes"]
    in_limits = (
        more["valid_per_minute"] >= options.at_least
        and max(found["one_process"]["valid_seconds"], more["valid_seconds"]) <= EACH
        and found["efficiency"] >= EFFICIENCY
        and found["resume_seconds"] <= RESUME
        and found["memory_megabytes"] <= MEMORY
    )
    return int(not in_limits)


if __name__ == "__main__":
    sys.exit(main())
