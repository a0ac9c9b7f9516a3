"""`haptorb fit-multipole`: the fitted model beats the published one with as many dipoles, and can be stored."""

import io
import json
import tomllib

import numpy as np
import pytest
from rich.console import Console

import haptorb
from haptorb.cli import main
from haptorb.cli.multipole_comparison import compare
from haptorb.errors import UnknownName


@pytest.fixture(scope="module")
def pmsm():
    return haptorb.load("pmsm")


@pytest.fixture(scope="module")
def magnet(pmsm):
    return compare(pmsm, "magnet")


def test_fitted_beats_published_with_no_more_dipoles(magnet):
    assert magnet.fitted.model.dipoles <= magnet.published.model.dipoles
    assert magnet.fitted.rms < 0.02 < magnet.published.rms


def test_the_stored_fit_gives_torque_to_half_a_percent(pmsm):
    rng = np.random.default_rng(5)
    R = haptorb.rotation_from_euler(*rng.uniform(-0.39, 0.39, (2, 20)), rng.uniform(0, 6.28, 20))
    exact = haptorb.torque_characteristic(pmsm, R)
    fitted = haptorb.torque_characteristic("pmsm-fitted", R, model="published")
    published = haptorb.torque_characteristic(pmsm, R, model="published")
    error = np.abs(fitted - exact).max() / np.abs(exact).max()
    assert error < 0.005
    assert np.abs(published - exact).max() / np.abs(exact).max() > 10 * error
    device = haptorb.load("pmsm-fitted")
    assert device.magnet_model.dipoles <= pmsm.magnet_model.dipoles
    assert device.coil_model.dipoles <= pmsm.coil_model.dipoles


def test_the_section_can_be_put_into_a_file(magnet):
    section = tomllib.loads(magnet.toml())["magnets"]["multipole"]
    model = magnet.fitted.model
    assert section["dipoles_per_loop"] == model.per_loop
    np.testing.assert_allclose(section["strengths"], model.loop_strengths, rtol=1e-5)


def test_numbers_text_and_plot(magnet, tmp_path):
    assert json.loads(json.dumps(magnet.numbers()))["fitted"]["dipoles"] == magnet.fitted.model.dipoles
    console = Console(file=io.StringIO(), width=100)
    magnet.show(console)
    assert "[magnets.multipole]" in console.file.getvalue()
    assert repr(magnet).startswith("<FitComparison of the magnet of pmsm: fitted and published")
    assert "[magnets.multipole]" in magnet._repr_html_()
    magnet.plot(tmp_path / "fit.svg")
    assert (tmp_path / "fit.svg").stat().st_size > 10_000


def test_mistakes_are_told(pmsm, capsys):
    with pytest.raises(UnknownName, match="did you mean 'magnet'"):
        compare(pmsm, "magnets")
    for arguments in (["--dipoles", "0"], ["--part", "rotor"], ["omni"], ["--plot", "/nowhere/x.png"]):
        assert main(["fit-multipole", *arguments]) == 2
        assert "haptorb:" in capsys.readouterr().err
