"""Report of a results file: content, files beside it, and results without a report."""

import json
import re
from base64 import b64decode
from dataclasses import replace
from functools import cache

import pytest

from haptorb.devices.loader import load, parse
from haptorb.errors import InputError
from haptorb_design import report
from haptorb_design.design_file import load_design, parse_design
from haptorb_design.evaluate import describe_base_forces
from haptorb_design.problem import build_device
from haptorb_design.report import BestDesign, make_best, make_page
from haptorb_design.results_table import ResultsTable
from haptorb_design.store import Results, Run, open_results, read_results
from oracles.command import run_command
from oracles.designs.made_designs import make_design, make_evaluations, make_results


def _make_plain(table, row, reason):
    """A best design without its card and drawing, which take seconds."""
    return BestDesign(row, table.name(row), reason, "# Found by design 'omni-core'\nname = 'x'\n", "card", b"")


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(report, "make_best", _make_plain)


@cache
def _table(count=300, goals=2, runs=1, method="sobol"):
    found = tuple(
        Run(number, method, number, {}, "0.1.0", "2026-01-01", tuple(make_evaluations(count, number)))
        for number in range(1, runs + 1)
    )
    return ResultsTable.of(Results(make_design(goals), found))


def _read(page):
    return json.loads(re.search(r"id='designs'>(.*?)</script>", page, re.S)[1])


def test_the_page_holds_every_valid_design_and_fetches_nothing():
    table = _table()
    page = make_page(table, [_make_plain(table, one.row, one.reason) for one in table.picks])
    shown = _read(page)
    assert len(shown["names"]) == len(table.found) == sum(one.valid for one in make_evaluations(300))
    assert shown["front"] == list(table.front)
    assert len(shown["picks"]) == 5
    columns = {one["title"]: one for one in shown["columns"]}
    assert columns["core pull"]["unit"] == "mN"
    assert columns["core radius"]["base"] == 15.0
    assert columns["rate"]["labels"] == ["<low>", "high & dear"]
    assert columns["continuous force"]["sense"] == 1
    row = shown["picks"][0]["row"]
    assert columns["core pull"]["values"][row] == pytest.approx(1e3 * table.found[row][1].objectives["core_pull"], 1e-5)
    assert "<low>" not in page  # nothing of a file is markup
    assert "Omni: &lt;core&gt; &amp; tool" in page
    addresses = re.findall(r"(?:src|href)=['\"]([^'\"]*)", page)
    assert all(one.startswith(("#", "data:")) for one in addresses)
    assert "default-src 'none'" in page
    for by, count in (("mass", 47), ("device", 31)):
        assert re.search(rf"{by}.*?</th><td class='n'>{count}</td>", page)
    assert "the &lt;coils&gt; overlap by 0.3 mm" in page


def test_sensitivity_is_of_the_sweeps_and_says_when_there_are_too_few():
    page = make_page(_table(), [])
    tables = re.findall(r"<caption>(.*?)</table>", page, re.S)
    assert len(tables) == 2
    assert re.search(r"core radius.*?(8|9)\d%", tables[0], re.S)  # of the pull, which goes with its fifth power
    assert tables[0].index("core radius") < tables[0].index("friction")
    assert "An optimiser chose them" in make_page(_table(method="nsga2"), [])
    assert "are not enough" in make_page(_table(30), [])


def test_no_valid_design_one_objective_and_several_runs_have_their_pages():
    refused = tuple(replace(one, objectives={}, refused_by="mass", reason="no") for one in make_evaluations(20))
    empty = ResultsTable.of(Results(make_design(), (Run(1, "grid", 1, {}, "0.1.0", "", refused),)))
    assert "There is no valid design" in make_page(empty, [])
    assert _read(make_page(empty, []))["names"] == []
    alone = _table(goals=1)
    assert len(alone.front) == 1
    assert alone.picks[0].row == alone.front[0]
    several = _table(60, runs=2)
    names = [several.name(row) for row in range(len(several.found))]
    assert len(set(names)) == len(names)
    assert names[0].startswith("omni-core-1-")


def test_a_base_device_whose_forces_are_computed_otherwise_is_marked(root, tmp_path):
    text = (
        'name = "own"\nbase = "omni"\n[objectives.core_pull]\n'
        '[parameters.core]\nlow = "12 mm"\nhigh = "15 mm"\nplaces = ["electromagnet.core_radius"]\n'
        '[parameters.fill]\nchoices = [0.65]\nplaces = ["windings.fill"]\n'
    )
    remark = describe_base_forces(parse_design(text, "own.toml", tmp_path), {"core": 12.5, "fill": "0.65"})
    assert "omni" in remark
    motor = load_design(root / "examples" / "design" / "motor-latitudes.toml")
    assert describe_base_forces(motor, {"coil_latitude": 25.5, "magnet_latitude": 20.0}) == ""
    table = _table()
    assert table.remark == _read(make_page(table, []))["remark"] == ""
    marked = replace(table, remark=remark)
    page = make_page(marked, [_make_plain(marked, marked.picks[0].row, "best")])
    assert _read(page)["remark"] == remark
    assert "omni *" in page
    assert "hollow" in page
    assert "hollow" not in make_page(table, [])


def test_a_best_design_is_a_device_file_that_loads_with_its_card_and_a_drawing(tmp_path):
    table = _table()
    pick = table.picks[0]
    made = make_best(table, pick.row, pick.reason)
    found = table.found[pick.row][1]
    device = parse(made.text, "found.toml")
    assert device.digest == build_device(table.design, found.values, made.name).digest
    assert device.name == made.name
    assert device.digest != load("omni").digest
    assert device.digest[:12] in made.card
    assert made.drawing.startswith(b"\x89PNG")
    page = make_page(table, [made])
    link = re.search(r"download='([^']+)' href='data:application/toml;base64,([^']+)'", page)
    assert link[1] == f"{made.name}.toml"
    assert b64decode(link[2]).decode() == made.text


def test_the_command_writes_all_files_and_says_which(quick, tmp_path, capsys, monkeypatch):
    make_results(tmp_path / "r.sqlite", 120)
    monkeypatch.chdir(tmp_path)
    code, out, _ = run_command(capsys, "design", "report", "r.sqlite", "--best", "2", "--json")
    assert code == 0
    told = json.loads(out)
    assert told["report"] == "report.html"
    assert len(told["devices"]) == 2
    assert all((tmp_path / one).exists() for one in (told["report"], *told["devices"]))
    assert run_command(capsys, "design", "report", "r.sqlite", "--best", "2")[0] == 0  # its own files may be replaced


def test_a_wrong_output_is_one_line_and_nothing_is_written(quick, tmp_path):
    results = make_results(tmp_path / "r.sqlite", 120)
    page = tmp_path / "report.html"
    name = report.write_report(results, page)[1]
    page.write_text("before")
    name.write_text("kind = 'mine'")
    for output, count, told in (
        (page, 5, "was not written by"), (tmp_path / "no" / "report.html", 5, "there is no folder"),
        (tmp_path, 5, "is a folder"), (page, 0, "from 1 to 20"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=told):
            report.write_report(results, output, count=count)
    assert page.read_text() == "before"
    assert name.read_text() == "kind = 'mine'"


@pytest.mark.parametrize("command", ["report", "show"])
def test_results_that_are_not_there_or_empty_are_refused(command, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text").write_text("no database")
    for name, told in (("none.sqlite", "does not exist"), ("text", "is not a database")):
        code, _, err = run_command(capsys, "design", command, name)
        assert code == 2
        assert told in err


def test_nothing_valid_cannot_be_shown(tmp_path, capsys):
    with open_results(tmp_path / "r.sqlite", make_design(), "sobol", 1) as writer:
        writer.add(replace(one, objectives={}, refused_by="mass", reason="no") for one in make_evaluations(9))
    code, _, err = run_command(capsys, "design", "show", str(tmp_path / "r.sqlite"))
    assert code == 2
    assert "mass rejects 9" in err


@pytest.mark.slow
def test_ten_thousand_designs_are_read_and_their_page_made(tmp_path):
    table = ResultsTable.of(read_results(make_results(tmp_path / "r.sqlite", 10_000)))
    assert len(table.found) > 7000
    assert len(make_page(table, [])) < 3_000_000
