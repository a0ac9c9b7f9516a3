"""Every `--help` as displayed: all texts, units and literals of the source, at any width."""

import re
import subprocess
import sys

import pytest
import typer

from haptorb.cli import main
from haptorb.cli.program import app

FRAME = str.maketrans(dict.fromkeys("│╭╮╰╯─┃", " "))  #: what a panel draws round a text


def commands(command, words=()):
    """(words to type, command) of `command` and all below it."""
    yield words, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from commands(inner, (*words, name))


EVERY = dict(commands(typer.main.get_command(app)))


def see(capsys, monkeypatch, width, *words):
    monkeypatch.setenv("COLUMNS", str(width))
    EVERY[()].main([*words, "--help"], prog_name="haptorb", standalone_mode=False)
    return capsys.readouterr().out


def flatten(text):
    return " ".join(text.translate(FRAME).split())


def lines(text):
    return [line for line in text.split("\n") if line]


@pytest.mark.parametrize("width", [80, 120])
@pytest.mark.parametrize("words", EVERY, ids=lambda words: " ".join(words) or "haptorb")
def test_nothing_that_the_source_says_is_missing_or_changed(capsys, monkeypatch, words, width):
    printed = see(capsys, monkeypatch, width, *words)
    command, told = EVERY[words], flatten(printed)
    assert max(map(len, lines(printed))) <= width
    for paragraph in (command.help or "").split("\n\n"):
        assert flatten(paragraph) in told
    for inner in getattr(command, "commands", {}).values():
        assert flatten(inner.help.split("\n\n")[0]) in told
    for parameter in command.params:
        text = getattr(parameter, "help", None)
        assert text is None or flatten(text) in told
        written = getattr(parameter, "metavar", None) if parameter.param_type_name == "argument" else None
        for name in [written] if written else parameter.opts + parameter.secondary_opts:
            assert re.search(rf"(^| ){re.escape(name)}(\.\.\.)?[, ]", told)
        if getattr(parameter, "show_default", False) and isinstance(parameter.default, int | float | str):
            assert isinstance(parameter.default, bool) or f"[default: {parameter.default}" in told


@pytest.mark.parametrize("words", EVERY, ids=lambda words: " ".join(words) or "haptorb")
def test_a_narrow_terminal_and_one_without_greek(capsys, monkeypatch, words):
    printed = see(capsys, monkeypatch, 38, *words)
    assert all(len(line) <= 38 or re.fullmatch(r" *\S+|.*\[default: \S+\]", line) for line in lines(printed))
    for parameter in EVERY[words].params:
        assert flatten(getattr(parameter, "help", None) or "") in flatten(printed)


def test_units_and_literals_that_were_lost_once(capsys, monkeypatch):
    for words, literals in {
        ("run",): ("is predicted [ms], 0 to 20", "serial:PORT or i2c:BUS"),
        ("check",): ("[ms]", "[Hz]"),
        ("hardware", "emulate"): ("centre [mm] (default",),
        ("calibrate",): ("(default: DEVICE.calibration.json)",),
    }.items():
        told = flatten(see(capsys, monkeypatch, 80, *words))
        for literal in literals:
            assert literal in told


def test_an_error_message_is_no_markup_either(capsys):
    with pytest.raises(SystemExit):
        main(["run", "--no[bold]such"])
    assert "--no[bold]such" in capsys.readouterr().err


def test_outputs_that_carry_ascii_only():
    """What a pipe in an old locale gets: signs spelled, nothing lost, no crash."""
    program = "from haptorb.cli import main; main(['check', '--help'])"
    done = subprocess.run(
        [sys.executable, "-c", program], env={"PYTHONIOENCODING": "ascii", "PYTHONPATH": ":".join(sys.path)},
        capture_output=True, check=True,
    )  # fmt: skip
    told = done.stdout.decode("ascii")
    assert "in kg, N.s/m, N/m" in flatten(told)
    assert told.count("?") == EVERY[("check",)].help.count("?")
