"""Multipole models: positions, moments and fields; accuracy of fits; published interpretations by name."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb.errors import GeometryError, InputError, UnknownName
from haptorb.magnetics import dipole
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.magnets import CylinderMagnet
from haptorb.magnetics.multipole import PUBLISHED, MultipoleSource, load_published
from haptorb.magnetics.multipole_fit import fit_multipole, residual, shell_region
from oracles.magnetics.multipole_wrench import multipole_wrench

MAGNET = CylinderMagnet(15.875e-3, 5.08e-3, 1.31)
REGION = shell_region(67.9e-3, 53.0e-3, 60.6e-3, 1.2, count=600)


def test_poles_stand_where_equation_7_puts_them():
    """a_j = a j/(k + 1), the loop j = 0 a single pair, poles at z = ±l̄/2."""
    model = MultipoleSource(0.04, 0.01, [1.0, 2.0, 3.0, 4.0], 6)
    assert model.dipoles == 1 + 3 * 6
    radii = np.hypot(model.poles[:, 0], model.poles[:, 1])
    assert radii[:19] == pytest.approx(np.concatenate([[0], np.repeat([0.01, 0.02, 0.03], 6)]))
    assert model.poles[:19, 2] == pytest.approx(0.005)
    assert model.poles[19:, 2] == pytest.approx(-0.005)
    assert model.strengths[:19] == pytest.approx(np.concatenate([[1], np.repeat([2.0, 3.0, 4.0], 6)]))
    assert model.strengths.sum() == 0
    assert model.moment[2] == pytest.approx((1 + 6 * 9) * 0.01)


def test_one_short_pair_is_a_dipole():
    pair = MultipoleSource(0.01, 1e-5, [1e3], 5)
    points = np.random.default_rng(1).normal(size=(20, 3))
    assert pair.dipoles == 1
    assert pair.field(points) == pytest.approx(dipole.field((0, 0, 1e-2), points), rel=1e-6)


def test_wrench_is_that_of_dipoles_far_apart():
    a, b = MultipoleSource(0.01, 1e-3, [50.0, 5.0], 8), MultipoleSource(0.02, 2e-3, [20.0], 1)
    place, turn = np.array([0.4, 0.3, -0.5]), np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])
    found = multipole_wrench(a, b, place, turn)
    assert found[:3] == pytest.approx(dipole.force(a.moment, turn @ b.moment, place), rel=1e-3)
    assert found[3:] == pytest.approx(dipole.torque(a.moment, turn @ b.moment, place), rel=1e-3)


def test_on_a_pole_there_is_no_field():
    with pytest.raises(GeometryError, match="pole"):
        MultipoleSource(0.01, 0.002, [1.0], 1).field((0, 0, 0.001))


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((0, 1e-3, [1.0], 4), "radius"),
        ((1e-2, -1e-3, [1.0], 4), "pole_distance"),
        ((1e-2, 1e-3, [], 4), "loop_strengths"),
        ((1e-2, 1e-3, [[1.0]], 4), "loop_strengths"),
        ((1e-2, 1e-3, [np.nan], 4), "loop_strengths"),
        ((1e-2, 1e-3, [1.0], 0), "per_loop"),
        ((1e-2, 1e-3, [1.0], 2.5), "per_loop"),
    ],
)
def test_wrong_models_are_refused(arguments, named):
    with pytest.raises(InputError, match=named):
        MultipoleSource(*arguments)


def test_the_region_fills_its_shell_evenly():
    points = shell_region(67.9e-3, 53.0e-3, 60.6e-3, 0.8, count=4000)
    about_centre = points + np.array([0, 0, 67.9e-3])
    radius = np.linalg.norm(about_centre, axis=1)
    assert radius.min() > 53.0e-3 - 1e-9
    assert radius.max() < 60.6e-3 + 1e-9
    cosine = about_centre[:, 2] / radius
    assert cosine.min() > np.cos(0.8) - 1e-9
    assert np.mean(cosine) == pytest.approx((1 + np.cos(0.8)) / 2, abs=2e-3)
    assert np.mean(radius**3) == pytest.approx((53.0e-3**3 + 60.6e-3**3) / 2, rel=2e-3)
    assert np.abs(points[:, :2].mean(axis=0)).max() < 2e-4


def test_a_model_is_found_again_from_its_own_kind_of_field():
    """A long thin magnet is two points: one pole pair fits its far field, as far apart as the magnet is long."""
    needle = CylinderMagnet(0.2e-3, 20e-3, 1.0)
    points = shell_region(60e-3, 20e-3, 40e-3, 3.0, count=300)
    fit = fit_multipole(needle, points, loops=0)
    assert fit.model.dipoles == 1
    assert fit.rms < 2e-4
    assert fit.model.pole_distance == pytest.approx(20e-3, rel=1e-3)
    assert fit.model.moment[2] == pytest.approx(needle.moment[2], rel=1e-2)


def test_the_search_keeps_the_budget_beats_a_fixed_choice_and_tells_its_progress():
    told: list[tuple[int, int]] = []
    fixed = fit_multipole(MAGNET, REGION, loops=3, per_loop=8, pole_distance=2.54e-3)
    found = fit_multipole(MAGNET, REGION, most_dipoles=25, progress=lambda done, total: told.append((done, total)))
    assert found.model.dipoles <= 25
    assert found.rms <= fixed.rms
    assert [done for done, _ in told] == list(range(1, told[-1][1] + 1))


def test_what_is_reported_is_what_is_left():
    fit = fit_multipole(MAGNET, REGION, loops=4, per_loop=10, pole_distance=1e-3)
    off = np.linalg.norm(fit.model.field(REGION) - MAGNET.field(REGION), axis=1)
    size = np.linalg.norm(MAGNET.field(REGION), axis=1)
    assert fit.rms == pytest.approx(np.sqrt((off**2).sum() / (size**2).sum()))
    assert fit.greatest == pytest.approx(off.max() / size.max())
    assert residual(MAGNET, fit.model, REGION) == fit
    # least squares: no small change of any strength makes it better
    for loop in range(5):
        for change in (0.999, 1.001):
            strengths = fit.model.loop_strengths.copy()
            strengths[loop] *= change
            assert residual(MAGNET, MultipoleSource(MAGNET.radius, 1e-3, strengths, 10), REGION).rms >= fit.rms


def test_hopeless_fits_are_refused():
    with pytest.raises(GeometryError, match="inside"):
        fit_multipole(MAGNET, [[0, 0, 0.01], [0, 0, 0.001]])
    with pytest.raises(InputError, match="too few"):
        fit_multipole(MAGNET, [[0, 0, 0.01]], loops=4)
    with pytest.raises(InputError, match="more than 10 dipoles"):
        fit_multipole(MAGNET, REGION, loops=4, per_loop=10, most_dipoles=10)
    with pytest.raises(InputError, match="loops"):
        fit_multipole(MAGNET, REGION, loops=-1)
    with pytest.raises(InputError, match="pole_distance"):
        fit_multipole(MAGNET, REGION, loops=1, pole_distance=0.0)
    with pytest.raises(InputError, match="inner ≤ outer"):
        shell_region(67.9e-3, 60e-3, 50e-3, 1.0)


def test_published_models_have_names():
    assert load_published("bai2012-em").model.dipoles == 97
    with pytest.raises(UnknownName, match="did you mean 'bai2012-pm'"):
        load_published("bai2012-mp")
    for name, entry in PUBLISHED.items():
        assert isinstance(entry.body, CylinderMagnet if "-pm" in name else Coil)
