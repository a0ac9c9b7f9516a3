"""Items and their verdicts, the registry, the command; Fig. 8 through the whole chain."""

import json

import numpy as np
import pytest

from haptorb.apps.cli import main
from haptorb.apps.reproduce import Item, reproduced, reproductions
from haptorb.apps.reproduce.two_phases import two_phases
from haptorb.errors import UnknownName


def told(capsys, *words):
    try:
        code = main(list(words))
    except SystemExit as end:
        code = int(end.code or 0)
    out, err = capsys.readouterr()
    assert "Traceback" not in out + err
    return code, out, err


@pytest.mark.parametrize(
    ("published", "computed", "tolerance", "erratum", "verdict"),
    [
        (1.0, 1.04, 0.05, "", "agrees"),
        (1.0, 1.06, 0.05, "", "differs"),
        (1.0, 1.06, 0.05, "E7", "differs as erratum E7 says"),
        (None, 3.0, None, "", "no number printed"),
        (1.0, float("nan"), 0.05, "E7", "differs"),
        (None, float("inf"), None, "", "differs"),
    ],
)
def test_verdicts(published, computed, tolerance, erratum, verdict):
    item = Item("x", "bai2012", "Fig. 8", "a force", published, computed, "N", tolerance, erratum)
    assert item.verdict == verdict
    assert json.loads(json.dumps(item.numbers()))["verdict"] == verdict


def test_the_registry():
    assert {one.paper for one in reproductions("bai2012")} == {"bai2012"}
    assert len({(one.paper, one.name) for one in reproductions()}) == len(reproductions())
    with pytest.raises(UnknownName, match="bai2012"):
        reproductions("bai2021")
    with pytest.raises(UnknownName, match="figure 8"):
        reproduced("bai2012", "figure 88")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["bai2021"], "did you mean 'bai2012'"),
        (["bai2012", "--figure", "88"], "figure 8"),
        (["--figure", "8"], "one of a paper"),
        (["bai2012", "--figure", "8", "--table", "1"], "one of a paper"),
        (["bai2012", "--figure", "8", "--out", "/no/such/folder"], "does not exist"),
    ],
)
def test_a_mistake_is_one_message(capsys, words, said):
    code, out, err = told(capsys, "reproduce", *words)
    assert code == 2
    assert said in err
    assert not out


def test_a_figure_is_not_overwritten(capsys, tmp_path):
    (tmp_path / "bai2012-figure-8.png").write_text("precious")
    code, _, err = told(capsys, "reproduce", "bai2012", "--figure", "8", "--out", str(tmp_path))
    assert code == 2
    assert "--force" in err
    assert (tmp_path / "bai2012-figure-8.png").read_text() == "precious"


def test_figure_8_by_the_command(capsys, tmp_path):
    code, out, _ = told(capsys, "reproduce", "bai2012", "--figure", "8", "--out", str(tmp_path), "--json")
    items = {item["id"]: item for item in json.loads(out)}
    assert code == 0
    assert {item["verdict"] for item in items.values()} == {"agrees", "no number printed"}
    assert items["fig8-fx"]["computed"] == pytest.approx(49.7, abs=0.1)
    assert items["fig8-given"]["computed"] < 0.02
    assert (tmp_path / "bai2012-figure-8.png").stat().st_size > 50_000


def test_the_phases_through_the_chain():
    shares = []
    pull, right = two_phases(seed=3, report=shares.append)
    assert shares == sorted(shares)
    assert 0.0 <= shares[0] < shares[-1] <= 1.0
    # phase 1: the hand moves in a line, the plug keeps its tilt to the last digit, in y it stays
    assert np.ptp(pull.tilt) < 1e-12
    assert np.abs(pull["object"][:, 1]).max() < 5e-6
    assert (np.diff(pull["object"][:, 0]) > -2e-6).all()
    # phase 2: it stands where it was and turns to zero
    assert np.ptp(right["object"][:, 0]) < 1e-12
    assert abs(right.tilt[-1]) < np.radians(0.01)
    # T_ψ stands for F_Y' and T_λ for F_X', not the other way round (E6)
    asked, force = pull["asked"], pull["object_wrench"]
    ratio = asked[:, 3] / force[:, 1]
    assert np.ptp(ratio) / ratio.mean() < 0.01
    # the parts are what was wanted, and each by itself gives its torque only
    assert pull["wanted"] == pytest.approx(pull.psi + pull.lam + pull.phi + pull.rest, abs=1e-9)
    assert (right["mode"] == 2).all()
