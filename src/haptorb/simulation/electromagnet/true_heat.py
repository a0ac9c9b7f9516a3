"""How the simulated coils heat each other: not quite as in the device file, and the controller does not know.

Every capacity and conductance is off by itself, within the file's tolerance, and a little heat leaves the core through
the stand, which the file's network does not have.
"""

from __future__ import annotations

from dataclasses import replace
from zlib import crc32

import numpy as np

from haptorb.devices.device import Device
from haptorb.numerics.arrays import Array
from haptorb.physics.thermal_network import ThermalNetwork

__all__ = ["COILS", "NODES", "draw_network", "fill_step"]

COILS = 3
NODES = 2 * COILS + 1  #: windings, bodies, and a core, which uncoupled coils do not warm
_STAND = 0.05  #: conductance of the stand, as a share of that of all bodies to the air


def draw_network(device: Device, specimen: int = 0) -> ThermalNetwork:
    """A network that a `specimen` of `device` could have by its file; the file's own if its values are exact.

    Of one file and number it is always the same: noise changes from run to run, coils do not.
    """
    heat = device.coils.heat
    network = heat.network(device.channels)
    draw = np.random.Generator(np.random.PCG64([crc32(device.digest.encode()), specimen]))

    def spread(values: Array) -> Array:
        spread_values: Array = values * (1.0 + heat.tolerance * draw.uniform(-1.0, 1.0, values.shape))
        return spread_values

    between = np.triu(spread(network.exchange))
    to_air = spread(network.to_air)
    if heat.coupling is not None:
        to_air[-1] = _STAND * to_air.sum()
    return replace(network, capacity=spread(network.capacity), exchange=between + between.T, to_air=to_air)


def fill_step(network: ThermalNetwork, dt: float, out: Array) -> None:
    """`out` (7, 10) becomes the network's step over `dt` [s]; a core that is not there keeps its temperature."""
    step, n = network.step(dt), network.nodes
    out[:] = 0.0
    out[-1, NODES - 1] = 1.0
    out[:n, :n], out[:n, NODES:] = step[:, :n], step[:, n:]
