"""The torque table of zonal harmonics against the exact model."""

import numpy as np
import pytest

from haptorb.devices.tables import series_torque_table
from haptorb.errors import GeometryError
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.interaction import wrench
from haptorb.magnetics.magnets import CylinderMagnet
from haptorb.magnetics.source import PlacedSource


@pytest.mark.parametrize(
    ("magnet", "coil", "out", "inside"),
    [
        (CylinderMagnet(15.875e-3, 5.08e-3, 1.31), Coil(1000, 4.764e-3, 15.88e-3, 7.62e-3), 67.9e-3, 56.8e-3),
        (CylinderMagnet(6e-3, 12e-3, -1.2), Coil(90, 2e-3, 20e-3, 3e-3), 50e-3, 30e-3),
    ],
)
def test_the_series_is_the_exact_torque(magnet, coil, out, inside):
    table = series_torque_table(magnet, out, coil, inside)
    at, found, exact = np.array([0.0, 0.0, inside]), [], []
    for angle in (0.02, 0.15, 0.31, 0.5, 1.2, 2.9):
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        placed = PlacedSource(magnet, out * turn[:, 2], turn)
        on_coil = wrench(placed, coil, at, np.eye(3), about=np.zeros(3), precision=1e-8)
        exact.append(on_coil.value[4] / s)
        found.append(float(table.values(np.array([c]))[0][0, 0]))
    assert found == pytest.approx(exact, abs=1e-7 * np.abs(table.values(np.array([1.0]))[0]).max())
    assert table.bound < 1e-6


def test_parts_that_sweep_through_each_other_are_refused():
    magnet, coil = CylinderMagnet(15e-3, 6e-3, 1.3), Coil(100, 4e-3, 16e-3, 8e-3)
    with pytest.raises(GeometryError, match=r"coils reach 62\.10 mm"):
        series_torque_table(magnet, 65e-3, coil, 56e-3)
