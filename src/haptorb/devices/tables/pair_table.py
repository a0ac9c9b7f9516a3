"""One magnet with one coil, or with one sensor, as functions of a single angle: tabulated from the exact model.

Where magnets and coils are bodies of revolution and every axis, the sensors' too, goes through the device's centre,
symmetry leaves three functions of one cosine: the torque of a magnet with axis u and a coil with axis c, per ampere,
is k(u·c) u × c on the magnet, and the magnet's field at a sensor in direction s is f(u·s) u + g(u·s) s. Each is
expanded in cosines of the angle (the exact model is asked a few hundred times, the series' tail is the error), then
laid out as quintic pieces over the chord |u − c| from 0 to 2, twice continuously differentiable, for `table_kernels`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from haptorb.errors import GeometryError, InputError, PrecisionError
from haptorb.numerics.arrays import Array, check_finite
from haptorb.physics.interaction import wrench
from haptorb.physics.sources.coil import Coil
from haptorb.physics.sources.placement import PlacedSource
from haptorb.physics.sources.round_body import RoundBody

__all__ = ["PairTable", "Progress", "chord_pieces", "field_table", "torque_table"]

Progress = Callable[[int, int], None]  #: called with (done, total) evaluations of the exact model

_FIRST, _LAST = 96, 3072  #: angles asked: first try, and the most that are tried
_FEWEST, _MOST = 256, 8192  #: cells of a table


@dataclass(frozen=True, slots=True)
class PairTable:
    """Functions of u·c as quintic pieces over the chord x = |u − c|, all pieces equally wide.

    cells   (n + 1, 6 q) coefficients of t⁰…t⁵ of q functions side by side; piece i covers x·scale from i to i + 1 and
            t = x·scale − i; the last row continues the one before, for chords a rounding error beyond 2
    scale   pieces per unit of chord
    bound   greatest error that was found, relative to each function's greatest magnitude
    """

    cells: Array
    scale: float
    bound: float

    @property
    def functions(self) -> int:
        """How many functions stand side by side: 1 (k) or 2 (f and g)."""
        return int(self.cells.shape[1]) // 6

    def values(self, cosine: Array) -> tuple[Array, Array]:
        """The functions (q, ...) and their derivatives by the cosine (q, ...), for cosines (...) in [−1, 1].

        >>> table = PairTable(np.array([[1.0, 2, 0, 0, 0, 0], [3, 2, 0, 0, 0, 0]]), 0.5, 0.0)    # 1 + x
        >>> value, slope = table.values(np.array([-1.0]))
        >>> value.tolist(), slope.tolist()
        ([[3.0]], [[-0.5]])
        """
        chord = np.sqrt(np.maximum(2 - 2 * check_finite(cosine, "cosine"), 1e-30))
        piece = np.minimum((chord * self.scale).astype(np.int64), len(self.cells) - 1)
        t = chord * self.scale - piece
        c = np.moveaxis(self.cells[piece].reshape(*piece.shape, self.functions, 6), -1, 0)
        c = np.moveaxis(c, -1, 1)
        value = c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))
        slope = c[1] + t * (2 * c[2] + t * (3 * c[3] + t * (4 * c[4] + t * 5 * c[5])))
        return value, -slope * self.scale / chord  # dx/d(cosine) = −1/x


def torque_table(
    magnet: RoundBody,
    magnet_distance: float,
    coil: Coil,
    coil_distance: float,
    *,
    precision: float = 1e-8,
    progress: Progress | None = None,
) -> PairTable:
    """k [N·m/A]: torque about the centre on a magnet with axis u is k(u·c) u × c for one ampere in a coil with axis c.

    The bodies' centres are `magnet_distance` and `coil_distance` [m] from the device's centre, their own z axes point
    outward. `precision` is relative to the greatest |k|. Raises PrecisionError, and GeometryError where they overlap.
    """
    at = np.array([0.0, 0.0, _distance(coil_distance, "coil_distance")])
    out = _distance(magnet_distance, "magnet_distance")
    upright = np.eye(3)

    def k(angles: Array, report: Callable[[], None]) -> Array:
        values = np.empty((1, len(angles)))
        for i, angle in enumerate(angles):
            c, s = np.cos(angle), np.sin(angle)
            turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
            on_coil = wrench(
                PlacedSource(magnet, out * turn[:, 2], turn),
                coil,
                at,
                upright,
                about=np.zeros(3),
                precision=0.1 * precision,
            )
            values[0, i] = on_coil.value[4] / s  # u × c = −s ŷ, and the magnet feels the opposite torque
            report()
        return values

    return _tabulate(k, precision, progress)


def field_table(
    magnet: RoundBody,
    magnet_distance: float,
    sensor_distance: float,
    *,
    precision: float = 1e-8,
    progress: Progress | None = None,
) -> PairTable:
    """f and g [T]: the field of a magnet with axis u at a sensor in direction s is f(u·s) u + g(u·s) s.

    The magnet's centre and the sensor are `magnet_distance` and `sensor_distance` [m] from the device's centre, the
    magnet's z axis points outward. `precision` is relative to the greatest |f| and |g|. Raises as `torque_table`.
    """
    out = _distance(magnet_distance, "magnet_distance")
    sensor = _distance(sensor_distance, "sensor_distance")

    def fg(angles: Array, report: Callable[[], None]) -> Array:
        c, s = np.cos(angles), np.sin(angles)
        points = np.stack([sensor * s, np.zeros_like(s), sensor * c - out], axis=1)
        if magnet.contains(points).any():
            raise GeometryError(
                f"sensors at {sensor} m from the centre pass through {magnet!r} at {out} m: move them apart"
            )
        field = magnet.field(points)
        for _ in angles:
            report()
        g = field[:, 0] / s  # B_ρ lies along (s − c u)/sinθ
        return np.array([field[:, 2] - g * c, g])

    return _tabulate(fg, precision, progress)


def _distance(value: float, what: str) -> float:
    number = check_finite(value, what)
    if number.ndim or number < 0:
        raise InputError(f"{what} must be one distance in metres, not negative; got {value!r}")
    return float(number)


def _tabulate(
    exact: Callable[[Array, Callable[[], None]], Array], precision: float, progress: Progress | None
) -> PairTable:
    if not 0 < float(check_finite(precision, "precision")) < 1:
        raise InputError(f"precision must be a relative error between 0 and 1; got {precision!r}")
    series, tail = _series(exact, precision, progress)
    cells, gap = chord_pieces(series, _FEWEST)
    while gap > 0.5 * precision and len(cells) <= _MOST:
        cells, gap = chord_pieces(series, 2 * (len(cells) - 1))
    bound = tail + gap + 0.1 * precision  # what the exact model itself may be off
    if bound > 2 * precision:
        raise PrecisionError(
            f"a table of {_MOST} cells is precise to {bound:.1e} relative; {precision:.1e} was requested"
        )
    return PairTable(cells, 0.5 * (len(cells) - 1), float(bound))


def _series(
    exact: Callable[[Array, Callable[[], None]], Array], precision: float, progress: Progress | None
) -> tuple[Array, float]:
    """Chebyshev coefficients (q, n) in the cosine, and the size of the tail relative to the greatest value."""
    from scipy.fft import dct  # a quarter of a second that only those who make tables should wait

    count, done = _FIRST, 0
    while True:
        total = done + count

        def report(total: int = total) -> None:
            nonlocal done
            done += 1
            if progress is not None:
                progress(done, total)

        values = exact(np.pi * (np.arange(count) + 0.5) / count, report)
        series = dct(values, type=2, axis=1) / count
        series[:, 0] *= 0.5
        size = np.maximum(np.abs(values).max(axis=1), 1e-300)
        tail = float((np.abs(series[:, -count // 8 :]).max(axis=1) / size).max())
        if tail * 4 <= 0.25 * precision:  # coefficients fall geometrically: what follows is a few times the last ones
            return series, tail * 4
        if 2 * count > _LAST:
            raise PrecisionError(
                f"a table of {count} angles is precise to {4 * tail:.1e} relative; {precision:.1e} was requested: "
                "move the parts further apart, or request less"
            )
        count *= 2


def chord_pieces(series: Array, count: int) -> tuple[Array, float]:
    """(count + 1, 6 q) quintic pieces of q functions, laid out as `PairTable.cells`, and their error in between.

    series (q, n) are Chebyshev coefficients in the cosine; each piece takes value and two derivatives at its ends. The
    error is relative to each function's greatest magnitude.
    """
    step = 2.0 / count
    x = step * np.arange(count + 1)
    cosine = 1 - 0.5 * x**2
    first = chebyshev.chebder(series, axis=1)
    second = chebyshev.chebder(first, axis=1)
    value = chebyshev.chebval(cosine, series.T)
    by_cosine = chebyshev.chebval(cosine, first.T)
    y, d, dd = value, -x * by_cosine * step, (x**2 * chebyshev.chebval(cosine, second.T) - by_cosine) * step**2
    rise = y[:, 1:] - y[:, :-1]
    d0, d1, e0, e1 = d[:, :-1], d[:, 1:], dd[:, :-1], dd[:, 1:]
    pieces = np.stack(
        [
            y[:, :-1],
            d0,
            0.5 * e0,
            10 * rise - 6 * d0 - 4 * d1 - 1.5 * e0 + 0.5 * e1,
            -15 * rise + 8 * d0 + 7 * d1 + 1.5 * e0 - e1,
            6 * rise - 3 * (d0 + d1) - 0.5 * (e0 - e1),
        ],
        axis=-1,
    )
    gap = 0.0
    size = np.maximum(np.abs(value).max(axis=1), 1e-300)
    for t in (0.25, 0.5, 0.75):
        true = chebyshev.chebval(1 - 0.5 * (x[:-1] + t * step) ** 2, series.T)
        found = np.polynomial.polynomial.polyval(t, np.moveaxis(pieces, -1, 0))
        gap = max(gap, float((np.abs(found - true).max(axis=1) / size).max()))
    last = np.zeros((len(series), 1, 6))  # beyond x = 2 only rounding errors go
    last[:, 0, 0], last[:, 0, 1], last[:, 0, 2] = y[:, -1], d[:, -1], 0.5 * dd[:, -1]
    cells = np.concatenate([pieces, last], axis=1)
    return np.ascontiguousarray(np.moveaxis(cells, 0, 1).reshape(count + 1, -1)), gap
