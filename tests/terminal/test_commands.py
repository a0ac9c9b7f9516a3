"""Output of the commands, in a uniform style."""

import ast
import json
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace

import pytest
import typer
from rich.cells import cell_len

from haptorb.cli.program import app
from haptorb.worlds import CATALOGUE
from haptorb.worlds.base import parameters

#: commands that print no table: they run something, write files, or only tell where these are
WITHOUT_JSON = {
    "design show",
    "study run",
    "study figures",
    "study new",
    "study simulate",
    "study export",
    "study backup",
    "hardware emulate",
    "exec",
    "libraries",
}
COMMAND = typer.main.get_command(app)


def text_of(capsys, monkeypatch, width, *words):
    monkeypatch.setenv("COLUMNS", str(width))
    COMMAND.main(list(words), prog_name="haptorb", standalone_mode=False)
    out = capsys.readouterr().out
    assert all(cell_len(line) <= width or len(line.split()) == 1 for line in out.splitlines())
    return " ".join(out.split())


@pytest.mark.parametrize("width", [80, 120, 38])
def test_every_parameter_of_every_world(capsys, monkeypatch, width):
    listed = text_of(capsys, monkeypatch, width, "worlds")
    for name, world in CATALOGUE.items():
        assert " ".join((world.__doc__ or "").splitlines()[0].split()) in listed
        text = text_of(capsys, monkeypatch, width, "worlds", name)
        for item in parameters(world).values():
            assert item.name in text
            assert f"{item.low:g} … {item.high:g}" in text
            assert item.unit in text


def test_a_device_file_is_printed_as_it_is(capsys, monkeypatch):
    """Its lines are longer than the terminal; wrapped, it is no TOML."""
    monkeypatch.setenv("COLUMNS", "80")
    COMMAND.main(["devices", "omni"], prog_name="haptorb", standalone_mode=False)
    file = files("haptorb.devices") / "catalogue" / "omni.toml"
    assert capsys.readouterr().out == file.read_text(encoding="utf-8")


@pytest.mark.parametrize("width", [80, 120])
def test_what_is_assumed(capsys, monkeypatch, width):
    from haptorb.devices.loader import load

    text = text_of(capsys, monkeypatch, width, "inspect", "omni", "--assumed")
    for key, reason in load("omni").assumed.items():
        assert key in text
        assert " ".join(reason.split()[:3]) in text
    assert json.loads(text_of(capsys, monkeypatch, 10_000, "inspect", "omni", "--assumed", "--json")) == dict(
        load("omni").assumed
    )


@pytest.mark.parametrize("width", [80, 120])
def test_statements_of_a_paper(capsys, monkeypatch, width):
    from haptorb_papers.cli.reproduce import _show
    from haptorb_papers.reproduce.item import Item

    items = (
        Item("x", "bai2012", "Fig. 8", "least force [of all] that is felt", 1.0, 1.02, "N", 0.05),
        Item("y", "zarate2020", "§II.B", "a current", 24.0, 20.0, "A", 0.1, "E15", corrected=20.0),
    )
    monkeypatch.setenv("COLUMNS", str(width))
    _show([SimpleNamespace(items=items)], [Path("page [1].html")])
    text = " ".join(capsys.readouterr().out.split())
    for part in ("Fig. 8: least force [of all]", "1.02", "contradicted (E15)", "page [1].html", "20 A"):
        assert part in text


def test_every_command_that_prints_figures_has_json():
    def names(command, words=()):
        inner = getattr(command, "commands", {})
        for name, one in inner.items():
            yield from names(one, (*words, name))
        if not inner:
            yield " ".join(words), {opt for parameter in command.params for opt in parameter.opts}

    without = {name for name, options in names(COMMAND) if "--json" not in options}
    assert without == WITHOUT_JSON


#: of what `test_nothing_prints_beside_it` looks for
ENDS = {"print", "Console", "echo", "write"}


def _name_of(function):
    """The last part of a called name; "" for what is no name."""
    return getattr(function, "attr", getattr(function, "id", ""))


def test_nothing_prints_beside_it(root):
    """No module of apps prints, or makes a console or a table of its own; a session's full screen is rich's."""
    places = ("src/haptorb/cli", "src/haptorb/serve", "src/haptorb/web", "src/haptorb_design", "src/haptorb_study")
    places += ("papers", "benchmarks/haptorb_bench")
    found = []
    for path in sorted(path for place in places for path in (root / place).rglob("*.py")):
        if path.name == "terminal_session.py":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            called = ast.unparse(node.func) if isinstance(node, ast.Call) and _name_of(node.func) in ENDS else ""
            if called == "Console" and isinstance(node, ast.Call) and node.args:
                continue  # the one in the browser
            if called in ("print", "console.print", "Console", "typer.echo", "sys.stdout.write"):
                found.append(f"{path.relative_to(root)}:{node.lineno} {ast.unparse(node)[:60]}")
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("rich."):
                names = {alias.name for alias in node.names} - {"Console"}
                found += [f"{path.relative_to(root)}:{node.lineno} {name}" for name in names]
    assert found == []


def test_an_option_that_would_lose_a_value_is_an_error(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    for words in (
        ["run", "--world", "dome", "--world", "wall"],
        ["inspect", "omni", "--plot", "a.png", "--plot=b.png"],
    ):
        with pytest.raises(SystemExit) as ended:
            COMMAND.main(words, prog_name="haptorb")
        assert ended.value.code == 2
        text = capsys.readouterr().err
        assert words[1 if words[0] == "run" else 2] in text
        assert "2 times" in text
