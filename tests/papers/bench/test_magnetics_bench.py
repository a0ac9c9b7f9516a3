"""`haptorb bench magnetics`: all computations agree, and the table is faster by orders of magnitude."""

import io
import json
import time
from importlib import import_module

import pytest
from rich.console import Console

from haptorb.cli import main
from haptorb.devices.api import torque_characteristic
from haptorb_bench import peers
from haptorb_bench.contest import Contest, Result, measure_fastest
from haptorb_bench.magnetics import magnetics

pytest.importorskip("magpylib")
pytest.importorskip("cfsem")


MAGNETICS = import_module("haptorb_bench.magnetics")


def measure_briefly(work, per_call, budget):
    """What takes long, once: the fastest of several runs is for those who compare."""
    start = time.perf_counter()
    work()
    once = time.perf_counter() - start
    return once / per_call if once > budget else measure_fastest(work, per_call, budget)


@pytest.fixture(scope="module")
def contest():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MAGNETICS, "measure_fastest", measure_briefly)
        return magnetics("pmsm", budget=0.02)


def rows(contest, part):
    return {(row.who, row.how): row for row in contest.results if row.task.startswith(part)}


@pytest.mark.slow
def test_everybody_agrees_with_the_reference_as_well_as_the_winding_allows(contest):
    torque, field = rows(contest, "torque"), rows(contest, "field")
    assert torque["haptorb", "table, one call"].error < 1e-6
    assert field["haptorb", "table, one call"].error < 1e-6
    assert torque["haptorb", "exact to 1e-7"].error < 1e-6
    for how in ("core in blocks", "getFT, one batch"):
        assert torque["magpylib", how].error < 1e-2
    assert torque["cfsem", "magnets as 16 loops"].error < 1e-2
    assert field["cfsem", "magnets as 16 loops"].error < 1e-6
    assert 0.01 < torque["haptorb", "published multipoles"].error < 0.1


@pytest.mark.slow
def test_numbers_text_and_plot(contest, tmp_path):
    numbers = json.loads(json.dumps(contest.numbers()))
    assert len(numbers["results"]) == len(contest.results)
    assert "magpylib" in numbers["machine"]
    console = Console(file=io.StringIO(), width=120)
    contest.show(console)
    assert "getFT" in console.file.getvalue()
    contest.plot(tmp_path / "bench.png")
    assert (tmp_path / "bench.png").stat().st_size > 10_000


def test_a_peer_that_is_not_installed_is_a_row_that_says_so(monkeypatch):
    monkeypatch.setattr(MAGNETICS, "find_spec", lambda name: None)
    monkeypatch.setattr(MAGNETICS, "measure_fastest", lambda work, per_call, budget: 1e-6)
    for name in ("torque_characteristic", "exact_torque"):  # the exact one takes seconds
        monkeypatch.setattr(MAGNETICS, name, lambda known, R, model="table": torque_characteristic(known, R))
    alone = magnetics("pmsm", budget=0.01)
    absent = [row for row in alone.results if row.who != "haptorb"]
    assert absent
    assert all(row.seconds is None for row in absent)
    console = Console(file=io.StringIO(), width=120)
    alone.show(console)
    assert "not installed" in console.file.getvalue()


def test_ratios_are_against_our_fastest():
    made = Contest(
        "t",
        (
            Result("a", "haptorb", "x", 2.0, 0.0),
            Result("a", "haptorb", "y", 1.0, 0.0),
            Result("a", "peer", "z", 30.0, 0.0),
        ),
        {},
    )
    assert made.ratios() == {"a": {"peer: z": 30.0}}


def test_fastest_is_per_item():
    calls = []
    assert measure_fastest(lambda: calls.append(1), per_call=10, budget=0.001) < 1e-4
    assert len(calls) >= 3


@pytest.mark.parametrize(
    "arguments",
    [
        ["fields"],
        ["--effort", "0"],
        ["--effort", "nan"],
        ["--plot", "x.gif"],
        ["--plot", "x.png", "--device", "omni"],
        ["magnetics", "omni", "--plot", "x.png"],
        ["tick", "--plot", "x.png"],
        ["--store", "/no/such/folder/x.json"],
    ],
)
def test_mistakes_are_told(arguments, capsys):
    assert main(["bench", *arguments]) == 2
    assert "haptorb:" in capsys.readouterr().err


def test_the_winding_has_every_coils_filaments():
    from haptorb.devices.loader import load

    winding = peers.Winding(load("pmsm"), 3, 2, 36)
    assert winding.points.shape == (24 * 6 * 36, 3)
