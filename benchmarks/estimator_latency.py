"""How long one update of each of a spherical motor's estimators takes, while the rotor swings at hand speed.

python benchmarks/estimator_latency.py [--json]
"""

from __future__ import annotations

import argparse
import json
from time import perf_counter

import numpy as np

import haptorb
from haptorb.devices.motor_doors import motor
from haptorb.physics.rotations import rotation_from_euler
from haptorb.sensing.estimator import Estimator
from haptorb.sensing.linear_map import LinearTorque
from haptorb.sensing.network import NetworkTorque, train
from haptorb.sensing.orientation import LeastSquaresOrientation
from haptorb.sensing.sample import Pose, Sample
from haptorb.sensing.torque_map import FieldToTorque

TICKS, PERIOD = 4000, 1e-3


def measured(estimator: Estimator, samples: list[Sample]) -> dict[str, float]:
    """Percentiles of one update [µs]."""
    seconds = []
    for sample in samples:
        begun = perf_counter()
        estimate = estimator.update(sample)
        seconds.append(perf_counter() - begun)
        assert estimate.valid
    p5, median, p99 = np.percentile(seconds[100:], (5, 50, 99)) * 1e6
    return {"p5_us": round(float(p5), 1), "median_us": round(float(median), 1), "p99_us": round(float(p99), 1)}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    as_json = parser.parse_args().json
    pmsm = motor(haptorb.load("pmsm"))
    t = PERIOD * np.arange(TICKS)
    R = rotation_from_euler(0.17 * np.sin(6 * t), 0.09 * np.sin(6 * t), 0.1 + 0.3 * np.sin(3 * t))
    field = pmsm.sensor_field(R, "table")
    field += pmsm.hall.noise * np.random.default_rng(0).standard_normal(field.shape)
    rest, none, cool = np.zeros(3), np.zeros(pmsm.channels), np.full(pmsm.channels, 293.0)
    nobody = Pose(0.0, np.eye(3), rest, rest, rest, False)
    samples = [Sample(float(at), none, cool, reading, nobody) for at, reading in zip(t, field, strict=True)]
    # how well the networks were trained does not change how long they take
    networks = NetworkTorque(pmsm, train(pmsm, starts=1, iterations=2, grid=(9, 9, 32)))
    result = {
        "network": measured(FieldToTorque(pmsm, networks), samples),
        "linear": measured(FieldToTorque(pmsm, LinearTorque(pmsm)), samples),
        "least_squares": measured(LeastSquaresOrientation(pmsm), samples),
        "network_beside_least_squares": measured(FieldToTorque(pmsm, networks, LeastSquaresOrientation(pmsm)), samples),
    }
    if as_json:
        print(json.dumps(result, indent=2))
    else:
        for name, times in result.items():
            print(f"{name:<30} {times}")


if __name__ == "__main__":
    main()
