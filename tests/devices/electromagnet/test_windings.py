"""Moments per ampere from the coils' sizes and the core: against a current loop, and beside the calibrated ones."""

from importlib.resources import files

import numpy as np
import pytest

from haptorb.devices.electromagnet.windings import Windings
from haptorb.devices.loader import load
from haptorb.errors import DeviceError
from haptorb.physics.sources.dipole import MU0
from haptorb.physics.sources.soft_sphere import SoftSphere

OMNI = load("omni")
CORE = SoftSphere(0.015)


def one(turns=1.0, inner=0.0219, outer=0.0221, length=2e-4):
    sizes = (np.full(3, value) for value in (turns, inner, outer, length))
    return Windings(*sizes)


def test_a_thin_coil_is_a_current_loop_with_a_sphere_in_its_middle():
    """Own moment π a²; field at the centre μ0/2a; a sphere of radius R in it: m = 4π R³ B/μ0, iron without limit."""
    own, induced = one().parts(CORE)[0]
    assert own == pytest.approx(np.pi * 0.022**2, rel=1e-4)
    assert induced == pytest.approx(4 * np.pi * 0.015**3 / MU0 * MU0 / (2 * 0.022), rel=1e-3)


def test_the_core_answers_as_its_permeability_says():
    """β = (µ − 1)/(µ + 2): nothing for µ = 1, all for infinity."""
    soft = one().parts(CORE)[0, 1]
    for mu, share in ((1.0001, 0.0001 / 3.0001), (4.0, 0.5), (1000.0, 999 / 1002)):
        assert one().parts(SoftSphere(0.015, mu))[0, 1] == pytest.approx(share * soft, rel=1e-6)


def test_turns_add_and_wider_coils_carry_more_moment_but_less_core():
    assert one(turns=80).parts(CORE) == pytest.approx(80 * one().parts(CORE))
    near, far = one().parts(CORE)[0], one(inner=0.0259, outer=0.0261).parts(CORE)[0]
    assert far[0] > near[0]
    assert far[1] < near[1]


def test_the_assumed_coils_of_omni_predict_the_calibrated_moments_within_5_percent():
    """Plausible, not proven: the sizes are assumed, knowing the moments; the order of the coils is the paper's."""
    predicted = np.diag(OMNI.predict_moments())
    assert predicted == pytest.approx(np.diag(OMNI.moment_per_current), rel=0.05)
    assert (np.diff(predicted) > 0).all()
    alone = OMNI.windings.parts(CORE)[:, 0]
    assert (alone < 0.8 * predicted).all()  # without the core a quarter and more would be missing


def parsed(tmp_path, old, new):
    text = files("haptorb.devices").joinpath("catalogue", "omni.toml").read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "other.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return load(path)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("value = [20.3, 22.3, 24.3]", "value = [10.3, 22.3, 24.3]", "coil 'x'"),
        ("value = [22.3, 24.3, 26.3]", "value = [22.3, 20.3, 26.3]", "coil 'y'"),
        ("value = [22.3, 24.3, 26.3]", "value = [22.3, 24.3, 36.3]", "coil 'z'"),
        ("turns = { value = [80, 80, 80]", "turns = { value = [80, 80]", "turns"),
        ("turns = { value = [80, 80, 80]", "turns = { value = [80, 80, -1]", "turns"),
        ('value = [18.0, 18.0, 18.0], unit = "mm"', 'value = [18.0, 18.0, 18.0], unit = "kg"', "length"),
    ],
)
def test_windings_that_cannot_be_are_named(tmp_path, old, new, word):
    with pytest.raises(DeviceError, match=word):
        parsed(tmp_path, old, new)


def test_a_device_without_sizes_predicts_nothing(tmp_path):
    text = files("haptorb.devices").joinpath("catalogue", "omni.toml").read_text(encoding="utf-8")
    start, end = text.index("[windings]"), text.index("[dome]")
    assert parsed(tmp_path, text[start:end], "").predict_moments() is None
