"""The servo loop alone: how late it starts its ticks, and what a tick costs, stage by stage.

python benchmarks/loop.py [--seconds 30] [--rate 1000] [--json]
"""

from __future__ import annotations

import argparse
import json
from time import monotonic

import numpy as np

from haptorb.runtime.row import STAGES
from haptorb.runtime.servo import Servo


def measured(seconds: float, rate: float) -> dict[str, object]:
    """The loop's own report, the start's duration [s], and the median of each stage [µs]."""
    begun = monotonic()
    with Servo("omni", "dome", rate=rate) as servo:
        started = monotonic() - begun
        servo.run(seconds)
        report = servo.report()
        rows = servo.rows()[1]
        stages = np.median(rows[:, servo.layout["stages"]], axis=0)
    return {
        "start_to_first_tick_s": round(started, 2),
        "rate_hz": rate,
        "ticks": report["ticks"],
        "success_rate": report["success_rate"],
        "lateness_us": report["lateness_us"],
        "compute_us": report["compute_us"],
        "stages_median_us": {name: round(1e6 * float(t), 1) for name, t in zip(STAGES, stages, strict=True)},
    }


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    print(json.dumps(measured(given.seconds, given.rate), indent=None if given.json else 2))


if __name__ == "__main__":
    main()
