"""`haptorb train` and `haptorb estimators`: output, figures, files, and rejected inputs."""

import json

import numpy as np
import pytest

import haptorb
from haptorb.cli import main
from haptorb.errors import InputError
from haptorb.estimation.network import read_networks, train
from haptorb_papers.estimators import compare, plot_comparison, print_comparison
from haptorb_papers.estimators.comparison import TORQUE_JND


@pytest.fixture(scope="module")
def comparison():
    """In a hurry: few orientations, a network of a few per cent."""
    pmsm = haptorb.load("pmsm")
    told = []
    networks = train(pmsm, starts=2, iterations=20, grid=(9, 9, 32))
    result = compare(pmsm, networks, orientations=12, report=told.append)
    assert told[-1] == 1.0
    return result


@pytest.mark.slow
def test_every_estimator_meets_every_disturbance(comparison):
    assert comparison.coil == 17
    assert comparison.estimators == ("network", "linear", "least-squares")
    assert repr(comparison).startswith("<EstimatorComparison of pmsm, electromagnet 17: network, linear, least-squares")
    assert "NRMSE" in comparison._repr_html_()
    assert len(comparison.rows) == 3 * len(comparison.disturbances)
    for row in comparison.rows:
        assert np.isnan(row.orientation) == (row.estimator != "least-squares")
        assert 0 <= row.torque < 0.06
        assert row.refused == 0


def test_least_squares_are_better_than_the_maps_by_orders_of_magnitude(comparison):
    for disturbance in comparison.disturbances:
        network, linear, best = (comparison.row(name, disturbance) for name in comparison.estimators)
        assert best.workspace < 0.25 * min(network.workspace, linear.workspace)
        assert best.jnd < 0.1
    exact = comparison.row("least-squares", "ideal sensors")
    assert exact.workspace < 1e-4
    assert exact.orientation < 0.005
    noisy = comparison.row("least-squares", "noise 0.1 mT")
    assert noisy.workspace < 5e-4
    assert noisy.orientation < 0.02
    assert noisy.torque < TORQUE_JND * 0.06 / 100


def test_it_can_be_read_printed_and_drawn(comparison, tmp_path, capsys):
    numbers = json.loads(json.dumps(comparison.numbers(), allow_nan=False))
    assert len(numbers["rows"]) == len(comparison.rows)
    from rich.console import Console

    print_comparison(comparison, Console(width=160))
    printed = capsys.readouterr().out
    assert "not estimated" in printed
    assert "magnets −2 %" in printed
    plot_comparison(comparison, tmp_path / "fig4.png")
    assert (tmp_path / "fig4.png").stat().st_size > 50_000


def test_train_keeps_networks_with_their_record_and_never_overwrites_unasked(tmp_path, capsys):
    path = tmp_path / "mine.network"
    arguments = ["train", "pmsm", "--starts", "1", "--iterations", "3", "--nodes", "4", "--out", str(path)]
    with pytest.raises(SystemExit) as ended:
        main([*arguments, "--json"])
    assert ended.value.code == 0
    told = json.loads(capsys.readouterr().out)
    assert told["file"] == str(path)
    assert told["nodes"] == 4
    assert 0 < told["judged"]["workspace"] < 1
    assert read_networks(path).record["judged"] == told["judged"]
    before = path.read_bytes()
    assert main(arguments) == 2
    assert "--force" in capsys.readouterr().err
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["train", "omni"], "works for spherical motors"),
        (["train", "pmsm", "--nodes", "0"], "1 to 200 nodes"),
        (["train", "pmsm", "--starts", "0"], "starts must be"),
        (["train", "pmsm", "--out", "/nowhere/at/all.network"], "does not exist"),
        (["estimators", "pmsm", "--orientations", "1"], "--orientations"),
        (["estimators", "pmsm", "--plot", "figure.txt"], "--plot"),
        (["estimators", "pmsm", "--networks", "/nowhere/at/all.network"], "haptorb train"),
    ],
)
def test_mistakes_are_one_message(arguments, said, capsys):
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert said in error
    assert "Traceback" not in error


def test_a_motor_without_networks_is_told_how_to_get_them(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    from haptorb.estimation.registry import field_estimator

    with pytest.raises(InputError, match="haptorb train pmsm"):
        field_estimator("network", haptorb.load("pmsm"))
