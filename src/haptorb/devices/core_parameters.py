"""Parameters of the soft core's response to changing currents: eddy currents that delay its moment, and remanence.

The core responds to the coils with a share of the whole moment. Eddy currents in it delay a part of that response; for
a sphere of conductivity σ and relative permeability µ in a uniform field the exact response is

    m(ω) = 2π a³ H [2µ(tanh k − k) + c]/[µ(tanh k − k) − c],   c = k² tanh k − k + tanh k,   k = a √(jω σ µ μ0)

(Wait, Geophysics 16, 666, 1951). `fit_eddy_lag` makes a first-order lag of it. Remanence follows the moment with a
play (backlash), the simplest hysteresis: after a moment of more than twice `reversing_moment` it has its full size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptorb.arrays import Array
from haptorb.errors import InputError
from haptorb.magnetics.dipole import MU0

__all__ = ["CoreDynamics", "fit_eddy_lag", "sphere_response"]


@dataclass(frozen=True)
class CoreDynamics:
    """Lag and hysteresis of the core, isotropic; all zero: the core follows the currents without delay or remanence.

    `spread` is the relative standard deviation, from device to device, of share, time and remanent moment.
    """

    eddy_share: float = 0.0  #: share of the whole moment that lags
    eddy_time: float = 1e-3  #: time constant of that lag [s]
    remanent_moment: float = 0.0  #: that stays along an axis after a large current [A·m²]
    reversing_moment: float = 1.0  #: change of the moment that reduces the remanence from full to zero [A·m²]
    spread: float = 0.0  #: relative

    def draw(self, specimen: int = 0) -> CoreDynamics:
        """The values of device number `specimen`: the same number, the same device.

        >>> drawn = CoreDynamics(0.015, 5.7e-3, 5e-3, 0.5, spread=0.3).draw()
        >>> drawn.spread, drawn.eddy_share == CoreDynamics(0.015, 5.7e-3, 5e-3, 0.5, spread=0.3).draw().eddy_share
        (0.0, True)
        """
        normal = np.random.Generator(np.random.PCG64([specimen, 0xC])).standard_normal(3)
        share, time, remanent = np.exp(np.log1p(self.spread) * normal)  # always positive, median 1
        return CoreDynamics(
            float(min(share * self.eddy_share, 0.99)),
            float(time * self.eddy_time),
            float(remanent * self.remanent_moment),
            self.reversing_moment,
        )

    def lag(self, frequency: float) -> float:
        """Size of what is missing of the whole moment at `frequency` [Hz], relative.

        >>> core = CoreDynamics(eddy_share=0.0149, eddy_time=5.67e-3)
        >>> round(100 * core.lag(10), 2), round(100 * core.lag(50), 2)
        (0.5, 1.3)
        """
        turn = 2 * np.pi * frequency * self.eddy_time
        return float(self.eddy_share * turn / np.hypot(1.0, turn))


def sphere_response(frequency: Array, radius: float, permeability: float, conductivity: float) -> Array:
    """(n,) complex: dipole moment of a sphere in a uniform field at `frequency` (n,) [Hz], relative to that at 0 Hz.

    radius [m], relative permeability above 1, conductivity [S/m]. Linear: without saturation.

    Raises InputError for other values.

    >>> steel = sphere_response(np.array([10.0, 50.0]), 15e-3, 1000.0, 6e6)
    >>> (100 * np.abs(1 - steel)).round(1).tolist()               # of the core's own moment
    [1.3, 3.2]
    """
    if not (radius > 0 and permeability > 1 and conductivity > 0):
        raise InputError(
            f"needs radius > 0, permeability > 1 and conductivity > 0; got {radius}, {permeability}, {conductivity}"
        )
    k = radius * np.sqrt(2j * np.pi * np.asarray(frequency) * conductivity * permeability * MU0)
    bend = np.tanh(k) - k
    c = k * k * np.tanh(k) + bend
    response: Array = (2 * permeability * bend + c) / (permeability * bend - c)
    return response / (2 * (permeability - 1) / (permeability + 2))


def fit_eddy_lag(
    radius: float,
    permeability: float,
    conductivity: float,
    core_share: float,
    frequencies: tuple[float, float] = (10.0, 50.0),
) -> tuple[float, float]:
    """Fit a first-order lag to the eddy currents of a conducting sphere in an alternating field.

    The lag misses the same share of the moment as the sphere at both frequencies.

    Parameters
    ----------
    radius : float
        Radius of the sphere [m].
    permeability : float
        Relative permeability [1].
    conductivity : float
        Conductivity [S/m].
    core_share : float
        Share of the core in the whole moment at rest [1].
    frequencies : tuple of float
        The two frequencies [Hz].

    Returns
    -------
    share : float
        Share of the whole moment that lags [1].
    time_constant : float
        Time constant of the lag [s].

    Raises
    ------
    InputError
        If no first-order lag does.

    Notes
    -----
    Wait's solution for a conducting permeable sphere in a uniform alternating field (Wait 1951).

    Examples
    --------
    >>> share, time = fit_eddy_lag(15e-3, 1000.0, 6e6, 0.39)
    >>> round(share, 3), round(1e3 * time, 1)
    (0.014, 6.4)
    """
    low, high = frequencies
    missing = core_share * np.abs(1 - sphere_response(np.array([low, high]), radius, permeability, conductivity))
    apart, grown = (high / low) ** 2, float(missing[1] / missing[0]) ** 2
    if not 1.0 < grown < apart:
        raise InputError(f"no first-order lag reduces {missing} of the moment at {low} and {high} Hz")
    turn = np.sqrt((apart - grown) / (apart * (grown - 1.0)))
    return float(missing[0] * np.hypot(1.0, turn) / turn), float(turn / (2 * np.pi * low))
