"""Every `haptorb ...` in documents, examples and messages is a valid command, in the form of its help.

A line of a code block must be complete. A command between backticks may leave out arguments (`haptorb run --frame
FILE`). Of one in running text, the names of command and options are checked. Capitals stand for any value.
"""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer

from haptorb.cli.program import app
from haptorb.devices.loader import catalogue
from haptorb.worlds import CATALOGUE

ROOT = Path(__file__).resolve().parents[3]
PROGRAM: Any = typer.main.get_command(app)
DEVICES = set(catalogue())
WORLDS = {*CATALOGUE, "nothing", "recorded"}

BLOCK = re.compile(r"^([ \t]*)```[^\n]*\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
BETWEEN_TICKS = re.compile(r"`haptorb( [a-z-][^`]+)`")
IN_TEXT = re.compile(rf"\bhaptorb ((?:{'|'.join(PROGRAM.commands)})\b(?![-.])[^`\"';,()<\n]*)")
PLACEHOLDER = re.compile(r"\[?[A-Z][A-Z0-9_]*(\.\w+)?\]?|…|\.\.\.|\{\w+\}")
END = {"|", ">", "&&", ";", "&", "2>"}


class Mention(NamedTuple):
    """A command line, where it stands, and how much of it must be there: all, some arguments, or only names."""

    place: str
    words: tuple[str, ...]
    kind: str


def split(line: str) -> tuple[str, ...]:
    """The words of a line up to the first pipe or redirection, without its comment."""
    words = shlex.split(line, comments=True)
    return tuple(words[: next((k for k, word in enumerate(words) if word in END), len(words))])


def find_in_document(text: str, place: str) -> Iterator[Mention]:
    """Commands of a Markdown page."""
    for _, block in BLOCK.findall(text):
        for line in block.replace("\\\n", " ").splitlines():
            if match := re.fullmatch(r"\s*(?:\$ |sudo )?haptorb ([a-z-].*)", line):
                yield Mention(place, split(match[1]), "whole")
    yield from find_mentions(BLOCK.sub("", text), place)


def find_mentions(text: str, place: str) -> Iterator[Mention]:
    """Commands between backticks and in running text."""
    for inner in BETWEEN_TICKS.findall(text):
        yield Mention(place, split(" ".join(inner.replace("\\", " ").split())), "mention")
    for inner in IN_TEXT.findall(BETWEEN_TICKS.sub("", text)):
        yield Mention(place, tuple(inner.split()), "names")


def find_in_program(text: str, place: str) -> Iterator[Mention]:
    """Commands in the strings and docstrings of a Python file; what an f-string fills in is a placeholder."""
    tree = ast.parse(text)
    inside = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
    inside -= {id(node) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            said = "".join(str(one.value) if isinstance(one, ast.Constant) else "VALUE" for one in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inside:
            said = node.value
        else:
            continue
        yield from find_mentions(said, f"{place}:{node.lineno}")


def find_all() -> Iterator[Mention]:
    """Commands of everything that people read."""
    documents = [
        path for path in (ROOT / "docs").rglob("*.md") if not {"_build", "generated", "gallery"} & {*path.parts}
    ]
    for path in [*documents, *ROOT.glob("*.md"), *(ROOT / "firmware").glob("*.md")]:
        yield from find_in_document(path.read_text(encoding="utf-8"), str(path.relative_to(ROOT)))
    for folder, suffixes in (
        ("src", {".py", ".toml", ".txt"}),
        ("examples", {".py", ".toml", ".rst", ".js", ".html"}),
        ("web/src", {".ts", ".html"}),
        ("docs/_ext", {".py"}),
        ("papers", {".py"}),
        ("benchmarks", {".py"}),
    ):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix not in suffixes or {"static", "node_modules"} & {*path.parts}:
                continue
            find = find_in_program if path.suffix == ".py" else find_mentions
            if "haptorb " in (text := path.read_text(encoding="utf-8")):
                yield from find(text, str(path.relative_to(ROOT)))


def list_choices(text: str) -> list[str]:
    """The forms that the help of an option lists, as expressions; empty if it lists none."""
    plain = re.sub(r" \([^)]*\)", "", text.partition("; ")[0]).rstrip(".")
    listed = re.split(r",? or |, ", plain.rpartition(": ")[2])
    if len(listed) < 2 or any(" " in one for one in listed):
        return []
    forms = []
    for form in listed:
        escaped = re.escape(form).replace(r"\[", "(?:").replace(r"\]", ")?")
        forms.append(re.sub(r"\b[A-Z]{2,}\b", r"[^:]+", escaped) if form != "3d" else "3d")
    return forms


def list_wrong_values(command: Any, values: dict[str, Any]) -> Iterator[str]:
    """What of the values of a command line has not the form that the help names."""
    for parameter in command.params:
        text = getattr(parameter, "help", None) or ""
        given = values.get(parameter.name)
        for value in given if isinstance(given, list | tuple) else [given]:
            if value is None or value == parameter.default or isinstance(value, bool):
                continue
            if isinstance(value, int | float):
                if bounds := re.search(r"([−\d.]+) to ([\d.]+)", text):
                    low, high = (float(one.strip(".").replace("−", "-")) for one in bounds.groups())
                    if not low <= value <= high:
                        yield f"{value:g} is not {low:g} to {high:g}"
                continue
            value = str(value)
            if PLACEHOLDER.fullmatch(value):
                continue
            choices = list_choices(text) if parameter.nargs == 1 else []
            parts = value.split(",") if "comma-separated" in text else [value]
            if choices and not all(any(re.fullmatch(one, part) for one in choices) for part in parts):
                yield f"'{value}' is none of {choices}"
            if "NAME=" in text and not re.fullmatch(r"[\w.-]+=.+", value):
                yield f"'{value}' is not NAME=VALUE"
            if parameter.name in ("device", "devices") and value not in DEVICES and not value.endswith(".toml"):
                yield f"there is no device '{value}'"
            if parameter.name == "world" and value not in WORLDS and not re.fullmatch(r"[\w./]+\.py(:\w+)?", value):
                yield f"there is no world '{value}'"


def list_mistakes(found: Mention) -> list[str]:
    """What is wrong with one command line."""
    command, words, path = PROGRAM, list(found.words), ["haptorb"]
    while hasattr(command, "commands") and words and not words[0].startswith("-"):
        alternatives = re.split(r" \| |, ", " ".join(words)) if "|" in words else [words[0]]
        name = re.sub(r"[.:?!]+$", "", words[0]) if found.kind == "names" else words[0]
        if missing := [one for one in alternatives[1:] if one.split()[0] not in command.commands]:
            return [f"{' '.join(path)} has no command {missing}"]
        if PLACEHOLDER.fullmatch(name) or len(alternatives) > 1:
            return []
        if name not in command.commands:
            return [] if found.kind == "names" and len(path) > 1 else [f"{' '.join(path)} has no command '{name}'"]
        command, path, words = command.commands[name], [*path, name], words[1:]
    always = {"--help", "-h", "--device"}
    options = {opt: one for one in command.params for opt in (*one.opts, *one.secondary_opts)}
    if unknown := [
        word for word in words
        if re.match(r"--?[a-zA-Z]", word) and re.split(r"[=.:?!]", word)[0] not in {*options, *always}
    ]:  # fmt: skip
        return [f"{' '.join(path)} has no option {unknown}"]
    if found.kind == "names" or hasattr(command, "commands") or {"--help", "-h"} & {*words}:
        return []
    words = [re.sub(r"^\[+|\]+$", "", word) if PLACEHOLDER.fullmatch(word) else word for word in words]
    words = ["1" if re.fullmatch(r"[A-Z]{1,2}", word) else word for word in words if word not in ("...", "…")]
    if found.kind == "mention" and words and words[-1] in options and not options[words[-1]].is_flag:
        words.pop()
    try:
        values = command.make_context(" ".join(path), words).params
    except Exception as mistake:  # Typer has classes of its own for these
        said = mistake.format_message() if hasattr(mistake, "format_message") else str(mistake)
        if found.kind == "mention" and type(mistake).__name__ == "MissingParameter":
            return []
        return [f"{' '.join(path)}: {said}"]
    return list(list_wrong_values(command, values))


def test_every_command_line_is_one_that_the_program_takes() -> None:
    every = list(find_all())
    assert sum(one.kind == "whole" for one in every) > 100
    assert sum(one.kind == "mention" for one in every) > 200
    wrong = [f"{one.place}: haptorb {' '.join(one.words)}: {said}" for one in every for said in list_mistakes(one)]
    assert wrong == [], "\n".join(wrong)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("```sh\nhaptorb walk omni\n```", "no command 'walk'"),
        ("```sh\nhaptorb run omni --walrus 3\n```", "no option"),
        ("```sh\nhaptorb run omni --duration soon\n```", "--duration"),
        ("```sh\nhaptorb run omni --serve haply:a:b:c:d\n```", "haply:a:b:c:d"),
        ("```sh\nhaptorb run omny\n```", "no device 'omny'"),
        ("```sh\nhaptorb run omni --world dom\n```", "no world 'dom'"),
        ("```sh\nhaptorb run omni --set moment:0.3\n```", "NAME=VALUE"),
        ("```sh\nhaptorb hardware jog x\n```", "--driver"),
        ("```sh\n$ haptorb run \\\n  omni --walrus\n```", "no option"),
        ("```sh\nhaptorb run omni --rate 9000\n```", "50 to 4000"),
        ("Use `haptorb study wake`.", "no command 'wake'"),
        ("Use `haptorb run --walrus FILE`.", "no option"),
        ("Use haptorb run --walrus.", "no option"),
    ],
)
def test_a_wrong_command_line_is_found(text: str, part: str) -> None:
    (found,) = find_in_document(text, "here")
    assert any(part in said for said in list_mistakes(found))


@pytest.mark.parametrize(
    "text",
    [
        "```sh\nhaptorb devices omni > mine.toml  # a copy\n```",
        "Use `haptorb run --frame FILE`, `haptorb study run --help` or `haptorb hardware jog`.",
        "`haptorb study new | check | run`",
        "Then haptorb design sweep, or haptorb bench.",
    ],
)
def test_a_right_command_line_is_not(text: str) -> None:
    assert [said for found in find_in_document(text, "here") for said in list_mistakes(found)] == []
