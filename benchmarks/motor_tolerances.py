"""Spread of the torque per ampere of a motor's coil within [tolerance], against `uncertainty.coil`.

    python benchmarks/motor_tolerances.py [pmsm] [pmsm-three-rings] [--motors 100] [--places 4] [--seed 1]

Simulated motors sum current loops and charges; the budget's rows are derivatives of zonal harmonics. At random
orientations the currents for a torque in a random direction are chosen by the controller's model, for the true
orientation or for the one that the estimator finds in the motor's true field. The first line is a motor that
differs from its file only by the last layer of its coils, which the wire does not fill; the budget has this in its
row for the turns of each layer. All others are what one tolerance changes from there. Printed are the root mean squares
of the torque's error, relative to the torque asked for, of the simulation and of the budget, with their statistical
errors (one standard deviation, of motors that are independent).
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from haptorb.analysis.motor_errors import MotorErrors, MotorPoint, motor_errors
from haptorb.arrays import Array
from haptorb.control.allocation import torque_allocator
from haptorb.devices.base import State
from haptorb.devices.field_sensors import SensorErrors, draw_sensors
from haptorb.devices.loader import load
from haptorb.devices.motor import SphericalMotor
from haptorb.devices.uncertainty import MotorTolerance
from haptorb.estimation.motor_orientation import LeastSquaresOrientation
from haptorb.estimation.types import Pose, Sample
from haptorb.simulation.motor_specimen import MotorTruth, draw_motor, fill_field, fill_torque

#: key of [tolerance] or [sensors], and the budget's row for it
ROWS = {
    "position": "positions of the coils",
    "tilt": "axes of the coils",
    "winding": "edges of the windings",
    "turns_per_layer": "turns of each layer of the windings",
    "magnet_position": "positions of the magnets",
    "magnet_tilt": "axes of the magnets",
    "placement": "field sensors, position",
}
EXACT = MotorTolerance.model_validate(
    {"winding": "0 mm", "position": "0 mm", "tilt": "0 deg", "turns_per_layer": 0.0, "magnet_position": "0 mm",
     "magnet_tilt": "0 deg"}
)  # fmt: skip


def isolate(device: SphericalMotor, key: str | None) -> SphericalMotor:
    """`device` with the tolerance `key` alone, or with none."""
    assert device.tolerance is not None
    known = device.uncertainty.model_copy(
        update={"polarization": 0.0, "polarization_spread": 0.0, "regulator": 0.0, "weight": 0.0}
    )
    only = EXACT
    if key in MotorTolerance.model_fields:
        only = EXACT.model_copy(update={key: getattr(device.tolerance, key)})
    errors = SensorErrors(placement=device.hall.errors.placement if key == "placement" else 0.0)
    return replace(device, tolerance=only, uncertainty=known, hall=replace(device.hall, errors=errors))


class Controller:
    """What chooses the currents, by the file of `device` alone."""

    def __init__(self, device: SphericalMotor) -> None:
        self._device, self._allocator = device, torque_allocator(device)
        self._estimator, self._t = LeastSquaresOrientation(device), 0.0

    def choose(self, R: Array, wrench: Array, field: Array | None, per_ampere: Array | None = None) -> Array:
        """(m,) [A] at the orientation R, or at that which the true `field` (k, 3) [T] of the magnets tells.

        per_ampere (m, 3 k) [T/A]: true field of the coils, which the sensors read too.
        """
        currents = self._allocator.allocate(self._device.wrench_map(State.from_rotation(R), "table"), wrench).currents
        if field is None or per_ampere is None:
            return currents
        for _ in range(3):  # the readings contain the coils' field
            read = field + (currents @ per_ampere).reshape(-1, 3)
            self._t += 1.0  # a gap after which the filter begins anew
            still = Pose(self._t, R, np.zeros(3), np.zeros(3), np.zeros(3), True)
            estimate = self._estimator.update(Sample(self._t, currents, np.full(len(currents), 298.0), read, still))
            currents = self._allocator.allocate(estimate.wrench_map, wrench).currents
        return currents


def draw_points(model: MotorErrors, number: int, places: int, seed: int) -> list[MotorPoint]:
    """Orientations and torques for one motor, the same for the simulation and the budget."""
    rng = np.random.default_rng([seed, number])
    return [model.draw_point(int(rng.integers(3)), rng) for _ in range(places)]


class Simulation:
    """Errors of simulated motors, driven by the controller of `device`."""

    def __init__(self, device: SphericalMotor, model: MotorErrors) -> None:
        self._device, self._model, self._controller = device, model, Controller(device)
        #: as in the file, but for layers of whole turns
        self._exact = draw_motor(isolate(device, None)).compile()

    def find_error(self, truth: MotorTruth, strength: Array, point: MotorPoint) -> Array:
        """(2, 3) [N·m] of a motor where the orientation is known, and where it is measured."""
        device, controller, found = self._device, self._controller, np.empty((2, 3))
        K, field = np.empty((3, device.channels)), np.empty((device.sensors, 3))
        fill_torque(truth, strength, point.R, K)
        fill_field(truth, strength, point.R, field)
        rest = device.passive(point.R)[3:] - point.wrench[3:]
        for way, seen in enumerate((None, field)):
            found[way] = K @ controller.choose(point.R, point.wrench, seen, truth.coil_field) + rest
        return found

    def draw_errors(self, key: str | None, motors: int, places: int, seed: int) -> Array:
        """(motors, places, 2, 3) [N·m] with the tolerance `key` alone; None: without any."""
        device, found = self._device, np.zeros((motors, places, 2, 3))
        family, polarity = isolate(device, key), np.array(device.polarity, dtype=np.float64)
        for number in range(motors):
            truth, strength = self._exact, polarity
            if key is not None:
                specimen = draw_sensors(family.hall.errors, device.sensors, seed + number)
                built = draw_motor(family, seed + number, specimen.placement)
                truth, strength = built.compile(), built.strength
            points = draw_points(self._model, number, places, seed)
            found[number] = [self.find_error(truth, strength, point) for point in points]
        return found


def compute_errors(model: MotorErrors, row: str | None, motors: int, places: int, seed: int) -> Array:
    """(motors, places, 3) [N·m] of that row of the budget alone, as `draw_errors` has them."""
    rng, found = np.random.default_rng(seed), np.empty((motors, places, 3))
    chosen = next(source for source in model.sources if source.name == (row or ROWS["turns_per_layer"]))
    for number in range(motors):
        deviates = rng.standard_normal(chosen.dimension)
        for place, point in enumerate(draw_points(model, number, places, seed)):
            trial, middle = model.make_trial(), model.make_trial()
            chosen.perturb(deviates, trial)
            chosen.perturb(0 * deviates, middle)
            of_middle = model.wrench_error(point, middle)
            found[number, place] = of_middle if row is None else model.wrench_error(point, trial) - of_middle
    return found


def find_rms(errors: Array) -> tuple[float, float]:
    """Root mean square over all but the last axis of the norm, and its standard deviation; the first axis: motors."""
    squares = (errors**2).sum(axis=-1).reshape(len(errors), -1).mean(axis=1)
    rms = float(np.sqrt(squares.mean()))
    return rms, float(squares.std() / np.sqrt(len(squares)) / (2 * rms)) if rms > 0 else 0.0


def main() -> None:
    """Print a table for each motor."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=["pmsm", "pmsm-three-rings"])
    parser.add_argument("--motors", type=int, default=100)
    parser.add_argument("--places", type=int, default=4, help="orientations of each motor")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    for name in given.names:
        device = load(name)
        assert isinstance(device, SphericalMotor)
        models = [motor_errors(device, None, estimator) for estimator in ("tracker", "least-squares")]
        asked = models[0].asked
        print(f"{name}: error of the torque [% of {1e3 * asked:.0f} mN·m], by simulation and by the budget's row")
        print(f"  {'':36s}{'orientation known':28s}measured by the field sensors")
        simulation = Simulation(device, models[1])
        exact = simulation.draw_errors(None, given.motors, given.places, given.seed)
        for key, row in ((None, None), *ROWS.items()):
            errors = exact
            if key is not None:
                errors = simulation.draw_errors(key, given.motors, given.places, given.seed) - exact
            line = f"  {row or 'last layer that is not full':36s}"
            for way, model in enumerate(models):
                if row is not None and row not in [source.name for source in model.sources]:
                    line += f"{'':28s}"
                    continue
                rows = compute_errors(model, row, given.motors, given.places, given.seed)
                both = [100 / asked * np.array(find_rms(one)) for one in (errors[:, :, way], rows)]
                line += "{:.2f} ± {:.2f}, {:.2f} ± {:.2f}  ".format(*np.concatenate(both)).ljust(28)
            print(line.rstrip(), flush=True)


if __name__ == "__main__":
    main()
