"""Forces of the card over the shell, against a search over directions with the required currents."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from haptorb.arrays import cap_directions
from haptorb.devices.base import State
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.electromagnet_capability import shell_capability
from haptorb.devices.loader import load

OMNI = load("omni")
STRONG = replace(OMNI, supply=replace(OMNI.supply, power=1e6))
WEAK = replace(OMNI, supply=replace(OMNI.supply, power=60.0))


def search(device: SphericalElectromagnet, distance: float, points: int) -> tuple[float, float]:
    """[N] the weakest radial and tangential force over places, and over 720 directions across the radius."""
    radial, tangential = [], []
    for u in cap_directions(device.workspace_half_angle, points):
        force = device.wrench_map(State.at(distance * u), "exact").force
        first = np.cross(u, [0.3, 0.9, 0.2])
        first /= np.linalg.norm(first)
        second = np.cross(u, first)
        turns = np.linspace(0.0, np.pi, 720, endpoint=False)
        for ways, found in (
            (u[None], radial),
            (np.outer(np.cos(turns), first) + np.outer(np.sin(turns), second), tangential),
        ):
            currents = np.linalg.solve(force, ways.T)  # of one newton each way, in columns
            within = (device.coils.current_limit[:, None] / np.abs(currents)).min(axis=0)
            watts = (device.greatest_resistance[:, None] * currents**2).sum(axis=0)
            found.append(float(np.minimum(within, np.sqrt(device.supply.power / watts)).min()))
    return min(radial), min(tangential)


@pytest.mark.parametrize("device", [OMNI, STRONG, WEAK], ids=["as it is", "limited by the coils", "by the supply"])
def test_the_weakest_forces_are_those_of_a_search(device: SphericalElectromagnet) -> None:
    """A search over half-degree steps misses the weakest direction by less than 0.1 %, and never finds a weaker one."""
    distance = device.contact_distance
    (layer,) = shell_capability(device, np.array([distance]), points=12).layers
    radial, tangential = search(device, distance, 12)
    assert layer.peak_radial == pytest.approx(radial, rel=1e-9)
    assert tangential * (1 - 1e-3) < layer.peak_tangential <= tangential * (1 + 1e-9)
