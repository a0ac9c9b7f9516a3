"""Reference of `--json`: a section for every command, with the keys of its output."""

from __future__ import annotations

import json
import re
from fnmatch import fnmatchcase

import pytest
import typer

from haptorb.cli.program import app, main

COMMAND = typer.main.get_command(app)
SECTION = re.compile(r"^## haptorb ([^\n]*?)( ✓)?\n(.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)
STUDY = re.compile(r"```toml\n(.*?)```", re.DOTALL)
#: what is run for the sections that are compared; bench: its stored result
SAMPLES = {
    "devices": ("", "omni"),
    "worlds": ("", "dome"),
    "keys": ("", "study levels"),
    "inspect": (
        "omni",
        "omni-small-core",
        "pmsm",
        "tetrahedron",
        "arm-touch",
        "arm-sigma",
        "omni --errors --samples 100",
        "pmsm --errors --samples 100",
    ),
    "show": ("omni", "pmsm", "arm"),
    "check": ("--world dome", "--world nothing"),
    "study check": ("study.toml",),
    "fit-multipole": ("--dipoles 40",),
    "bench": (),
}
#: keys that stand for others, or for nothing at all, in some samples only
EMPTY = {"check": {"critical"}, "study check": {"overlap"}}
#: lists, and a workspace, of which a device has none
WITHOUT = {"show": {"balls", "edges", "parts", "spots", "workspace"}}


@pytest.fixture(scope="module")
def sections(request):
    root = request.config.rootpath
    text = (root / "docs" / "reference" / "json-output.md").read_text(encoding="utf-8")
    return {name: (bool(compared), body) for name, compared, body in SECTION.findall(text)}


def list_commands(command, words=()):
    """Name and options of every command."""
    inner = getattr(command, "commands", {})
    for name, one in inner.items():
        yield from list_commands(one, (*words, name))
    if not inner:
        yield " ".join(words), {opt for parameter in command.params for opt in parameter.opts}


def list_paths(value, at=""):
    """Paths of all leaves, as the page writes them."""
    if isinstance(value, dict) and value:
        for key, part in value.items():
            yield from list_paths(part, f"{at}.{key}" if at else key)
    elif isinstance(value, list) and any(isinstance(part, dict | list) for part in value):
        for part in value:
            yield from list_paths(part, f"{at}[]")
    else:
        yield at


def list_documented(body):
    """The keys of a section's tables: what stands in backticks in the first column."""
    rows = [line.split("|")[1] for line in body.splitlines() if line.startswith("| `")]
    return [key for cell in rows for key in re.findall(r"`([^`]+)`", cell)]


def matches(path, key):
    """Whether the key of the page stands for `path`; its brackets are no patterns."""
    return fnmatchcase(path, key.replace("[", "[[]"))


def test_every_command_with_json_has_a_section(sections):
    assert set(sections) == {name for name, options in list_commands(COMMAND) if "--json" in options}


def test_the_compared_sections_are_those_that_can_be(sections):
    assert {name for name, (compared, _) in sections.items() if compared} == set(SAMPLES)


@pytest.mark.parametrize("name", SAMPLES)
def test_printed_keys_are_those_of_the_page(name, sections, capsys, tmp_path, monkeypatch, root):
    tutorial = (root / "docs" / "tutorials" / "study.md").read_text(encoding="utf-8")
    study = STUDY.search(tutorial)[1]
    (tmp_path / "study.toml").write_text(study, encoding="utf-8")
    printed = [json.loads((root / "docs" / "benchmarks.json").read_text(encoding="utf-8"))] if name == "bench" else []
    monkeypatch.chdir(tmp_path)
    for words in SAMPLES[name]:
        with pytest.raises(SystemExit) as end:
            main([*name.split(), *words.split(), "--json"])
        assert end.value.code in (0, 1)
        printed.append(json.loads(capsys.readouterr().out))
    paths = {path for one in printed for path in list_paths(one)} - WITHOUT.get(name, set())
    documented = list_documented(sections[name][1])
    unknown = [path for path in sorted(paths) if not any(matches(path, key) for key in documented)]
    assert unknown == [], "printed and not on the page"
    missing = [key for key in documented if not any(matches(path, key) for path in paths)]
    assert set(missing) <= EMPTY.get(name, set()), "on the page and never printed"
