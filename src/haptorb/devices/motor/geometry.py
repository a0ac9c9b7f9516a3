"""The bodies of a spherical motor: coils and field sensors of the stator, magnets and handle of the upright rotor."""

from __future__ import annotations

import numpy as np

from haptorb.devices.geometry import Geometry, Reach, Rod, RoundPart, Spot, list_assumed
from haptorb.devices.motor.spherical_motor import SphericalMotor

__all__ = ["motor_geometry"]

_SIZES = (
    *("magnets.distance", "magnets.radius", "magnets.length", "magnets.rings", "electromagnets.distance"),
    *("electromagnets.outer_radius", "electromagnets.inner_radius", "electromagnets.length", "electromagnets.rings"),
    *("sensors.distance", "sensors.rings", "rotor.handle_length", "workspace.tilt"),
    *(f"regulator.{side}.{key}" for side in ("stator", "rotor")
      for key in ("outer_radius", "inner_radius", "length", "height")),
)  # fmt: skip


def motor_geometry(device: SphericalMotor) -> Geometry:
    """The parts of `device`, its rotor upright and without spin."""
    handle = device.rotor.handle_length
    return Geometry(
        round_parts=(*_coils(device), *_magnets(device), *_regulator(device)),
        spots=tuple(Spot(f"sensor {n}", "sensor", at) for n, at in enumerate(device.sensor_layout.positions, 1)),
        rods=(Rod("handle", np.zeros(3), np.array([0.0, 0.0, handle])),),
        reach=Reach("end of the handle", device.workspace_tilt, handle, handle),
        notes=(
            "not stated in the device file: the rotor's shell, the bearing, the stator's body, the handle's thickness",
            *list_assumed(device.assumed, _SIZES),
        ),
    )


def _coils(device: SphericalMotor) -> tuple[RoundPart, ...]:
    coil, layout, names = device.electromagnet, device.electromagnets, device.coils.names
    channels = [next((names[m] for m in np.flatnonzero(row)), "") for row in device.groups]
    return tuple(
        RoundPart(
            f"EM{k + 1}", "coil", layout.positions[k], layout.directions[k], float(coil.inner_radius),
            float(coil.outer_radius), float(coil.length), channel=channels[k],
        )
        for k in range(len(layout))
    )  # fmt: skip


def _magnets(device: SphericalMotor) -> tuple[RoundPart, ...]:
    magnet, layout = device.magnet, device.magnets
    return tuple(
        RoundPart(
            f"PM{k + 1}", "magnet", layout.positions[k], layout.directions[k], 0.0, float(magnet.radius),
            float(magnet.length), polarity=float(device.polarity[k]), moves=True,
        )
        for k in range(len(layout))
    )  # fmt: skip


def _regulator(device: SphericalMotor) -> tuple[RoundPart, ...]:
    """The two rings that hold the rotor up: polarized against each other."""
    both = device.regulator
    if both is None:
        return ()
    up = np.array([0.0, 0.0, 1.0])
    rings = (
        ("regulator ring of the stator", both.stator_ring, both.stator_height, 1.0, False),
        ("regulator ring of the rotor", both.rotor_ring, both.rotor_height, -1.0, True),
    )
    return tuple(
        RoundPart(
            name, "ring", height * up, up, float(ring.inner_radius), float(ring.outer_radius), float(ring.length),
            polarity=sign, moves=moves,
        )
        for name, ring, height, sign, moves in rings
    )  # fmt: skip
