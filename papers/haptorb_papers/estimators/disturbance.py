"""What estimators are tried against: noise, offset, a sensor that fails, magnets that differ from the device file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.field_sensors import SensorErrors, draw_sensors
from haptorb.devices.motor import SphericalMotor
from haptorb.simulation.parts import FAILURES, greatest_reading, make_halls, read_halls, seed_noise

__all__ = ["NOISES", "Disturbance", "disturbances"]


@dataclass(frozen=True)
class Disturbance:
    """One way in which readings are not what the device's model says."""

    name: str
    noise: float | None = None  #: of one reading [T]; None: noise and step of the device file
    offset: float = 0.0  #: standard deviation over the sensors [T]
    gain: float = 0.0  #: standard deviation over the sensors, relative; as much again across axes
    failed: int = 0  #: number of the sensor that has failed, from 1; 0: none
    failure: str = "dead"
    strength: float = 1.0  #: of all magnets, relative to the device file

    def readings(self, motor: SphericalMotor, R: Array, seed: int = 0) -> Array:
        """(n, k, 3) [T], stator frame: what the sensors of `motor` say at R (n, 3, 3), no currents flowing."""
        ideal = self.noise is not None
        halls = make_halls(
            motor.sensor_layout.frames,
            draw_sensors(SensorErrors(self.gain, self.offset, self.gain), motor.sensors, seed),
            motor.hall.noise if self.noise is None else self.noise,
            0.0 if ideal else motor.hall.step,
        )
        if ideal:
            halls["reach"] = greatest_reading(motor.hall.step)
        if self.failed:
            halls["failure"][self.failed - 1] = FAILURES[self.failure]
        noise = seed_noise(seed)
        field = self.strength * motor.sensor_field(R, "table")
        for reading in field:
            read_halls(halls, noise, 0.0, reading)
        return field


NOISES = tuple(
    Disturbance(f"noise {1e3 * sigma:g} mT" if sigma else "ideal sensors", noise=sigma)
    for sigma in (0.0, 1e-5, 1e-4, 1e-3)
)


def _own_sensor(motor: SphericalMotor, coil: int) -> int:
    """Number, from 1, of the sensor nearest to the axis of `coil`, from 0."""
    return int(np.argmax(motor.sensor_layout.directions @ motor.electromagnets.directions[coil])) + 1


def disturbances(motor: SphericalMotor, coil: int) -> tuple[Disturbance, ...]:
    """All of them; the sensor that fails is the one on the axis of `coil`, from 0."""
    own = _own_sensor(motor, coil)
    return (
        *NOISES,
        Disturbance("as in the device file"),
        Disturbance("offset 0.5 mT", offset=0.5e-3),
        Disturbance("gain, cross-axis 1 %", gain=0.01),
        Disturbance(f"sensor {own} dead", failed=own),
        Disturbance(f"sensor {own} saturated", failed=own, failure="saturated"),
        Disturbance("magnets +2 %", strength=1.02),
        Disturbance("magnets −2 %", strength=0.98),
    )
