"""Winding volume: field, gradient and error bound, and electrical data."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from haptorb.errors import GeometryError, InputError, PrecisionError
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.dipole import MU0
from haptorb.magnetics.source import SheetStack

COIL = Coil(1000, 0.3 * 15.88e-3, 15.88e-3, 7.62e-3)
RI, RO, HALF = COIL.inner_radius, COIL.outer_radius, COIL.length / 2


def scatter(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3)) * 0.02


def test_field_agrees_with_many_sheets_outside():
    """400 current sheets at Gauss radii: exact wherever no sheet passes through the point."""
    x, w = np.polynomial.legendre.leggauss(400)
    middle, half = (RO + RI) / 2, (RO - RI) / 2
    sheets = SheetStack(middle + half * x, HALF, MU0 * 1000 / (COIL.length * (RO - RI)) * half * w)
    points = scatter(2000)
    rho = np.hypot(points[:, 0], points[:, 1])
    points = points[(rho < 0.95 * RI) | (rho > 1.05 * RO) | (np.abs(points[:, 2]) > 2 * HALF)]
    true = sheets.field(points)
    off = np.linalg.norm(COIL.field(points) - true, axis=1) / np.linalg.norm(true, axis=1)
    assert off.max() < 1e-10


def test_on_the_axis_the_textbook_formula_holds():
    """B = μ0 N/(2l(rₒ − rᵢ)) [ζ ln((rₒ + √(rₒ² + ζ²))/(rᵢ + √(rᵢ² + ζ²)))] between the two ends."""
    z = np.linspace(-0.03, 0.03, 31)

    def end(zeta):
        return zeta * np.log((RO + np.hypot(RO, zeta)) / (RI + np.hypot(RI, zeta)))

    true = MU0 * 1000 / (2 * COIL.length * (RO - RI)) * (end(z + HALF) - end(z - HALF))
    assert COIL.field(np.stack([0 * z, 0 * z, z], axis=1))[:, 2] == pytest.approx(true, rel=1e-10)


@pytest.mark.parametrize("precision", [1e-3, 1e-6, 1e-9])
def test_the_bound_holds_inside_and_outside(precision):
    points = scatter(1000, 1)
    value, bound = COIL.field_bounded(points, precision)
    true, rest = COIL.field_bounded(points, 1e-12)
    assert (np.abs(value - true).max(axis=1) <= bound + rest + 1e-15).all()


def test_gradient_is_the_derivative_of_the_field_in_the_winding_too():
    points = scatter(300, 2)
    h = 1e-6
    found = np.stack(
        [
            (COIL.field_bounded(points + h * e, 1e-12)[0] - COIL.field_bounded(points - h * e, 1e-12)[0]) / (2 * h)
            for e in np.eye(3)
        ],
        axis=-1,
    )
    gradient = COIL.field_gradient(points)
    off = np.abs(gradient - found).max(axis=(1, 2)) / np.abs(gradient).max(axis=(1, 2))
    assert np.percentile(off, 98) < 1e-6
    inside = COIL.contains(points)
    assert 5 < inside.sum() < 200
    curl = gradient[:, [2, 0, 1], [1, 2, 0]] - gradient[:, [1, 2, 0], [2, 0, 1]]
    density = MU0 * 1000 / (COIL.length * (RO - RI))
    assert np.linalg.norm(curl[inside], axis=1) == pytest.approx(density, rel=1e-6)
    assert np.abs(curl[~inside]).max() < 1e-6 * density
    assert np.abs(np.trace(gradient, axis1=1, axis2=2)).max() < 1e-9 * density


def test_finite_on_every_edge_but_its_gradient_is_not():
    corner = (RO, 0, HALF)
    assert np.isfinite(COIL.field(corner)).all()
    with pytest.raises((PrecisionError, GeometryError)):
        COIL.field_gradient(corner)


def test_unreachable_precision_names_the_best_reached():
    with pytest.raises(PrecisionError, match=r"converged to .* relative, not to 1\.0e-18"):
        COIL.field_bounded((RO * 0.9, 0, HALF * 0.9), 1e-18)


def test_series_takes_over_without_a_step():
    out = scatter(200, 3)
    out *= 4 * COIL.bounding_radius / np.linalg.norm(out, axis=1, keepdims=True)
    for quantity in (COIL.field, COIL.field_gradient):
        below, above = quantity(out * (1 - 1e-13)), quantity(out * (1 + 1e-13))
        assert np.abs(below - above).max() < 1e-9 * np.abs(above).max()


def test_moment_is_that_of_its_turns():
    r, _, turns = COIL.filaments(8, 3)
    assert COIL.moment[2] == pytest.approx((turns * np.pi * r**2).sum(), rel=1e-13)
    assert COIL.moment[2] == pytest.approx(0.36707, abs=5e-6)


def test_resistance_is_that_of_the_wire():
    fill = 0.6
    wire = np.sqrt(4 * fill * (RO - RI) * COIL.length / (1000 * np.pi))  # its copper fills that share
    long = 1000 * 2 * np.pi * (RI + RO) / 2
    assert COIL.resistance(fill, 1.7e-8) == pytest.approx(1.7e-8 * long / (np.pi * wire**2 / 4), rel=1e-12)
    volume = fill * np.pi * (RO**2 - RI**2) * COIL.length
    assert COIL.heat_capacity(fill) == pytest.approx(volume * 8890 * 385, rel=1e-12)


def test_inductance_of_a_long_solenoid_follows_nagaoka():
    """Current sheet of length twice its diameter: μ0 N² π a²/l times Nagaoka's 0.8181 (Grover, table 36)."""
    a, l = 0.01, 0.04
    thin = Coil(500, a * (1 - 1e-3), a * (1 + 1e-3), l)
    assert thin.inductance == pytest.approx(0.818136 * MU0 * 500**2 * np.pi * a**2 / l, rel=2e-3)


def test_inductance_is_the_flux_of_its_own_field():
    """λ = ∫ over the bore and the winding of B_z times the turns outside: an independent integral."""
    x, w = np.polynomial.legendre.leggauss(12)
    total = 0.0
    for height, weight in zip(HALF * x, 0.5 * w, strict=True):

        def linkage(r, height=height):
            turns = 1000 * min(1.0, (RO - r) / (RO - RI))
            return 2 * np.pi * r * turns * COIL.field_bounded((r, 0, height), 1e-8)[0][2]

        total += weight * (quad(linkage, 0, RI)[0] + quad(linkage, RI, RO)[0])
    assert COIL.inductance == pytest.approx(total, rel=1e-6)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((0, 1e-3, 2e-3, 1e-3), "turns"),
        ((10, 2e-3, 2e-3, 1e-3), "inner_radius must be below"),
        ((10, 0, 2e-3, 1e-3), "inner_radius"),
        ((10, 1e-3, np.inf, 1e-3), "outer_radius"),
        ((10, 1e-3, 2e-3, -1), "length"),
        ((10, 1e-3, 2e-3, 1e-3, 0), "precision"),
    ],
)
def test_wrong_windings_are_refused(arguments, named):
    with pytest.raises(InputError, match=named):
        Coil(*arguments)


@pytest.mark.parametrize("precision", [0, 1, -1e-6, np.nan, [1e-6, 1e-6]])
def test_precision_that_is_none_is_refused(precision):
    with pytest.raises(InputError, match="precision"):
        COIL.field_bounded((0, 0, 0), precision)


@pytest.mark.parametrize("fill", [0, -0.1, 1.1, np.nan])
def test_wrong_fill_is_refused(fill):
    with pytest.raises(InputError, match="fill"):
        COIL.resistance(fill)
