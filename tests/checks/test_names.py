"""How things are called: a function is a verb, a class has a name of its own. See CONTRIBUTING, Names."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

import haptorb

pytestmark = pytest.mark.background

Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef

#: participles that do not end in -ed, but not those that are the imperative too: put, set, read, run, cut, split
IRREGULAR = (
    " begun bent born borne bought broken brought built cast caught chosen come done drawn driven eaten fallen "
    " fed felt flown foretold forgotten found frozen given gone gotten grown heard held hidden hung kept known "
    " laid lain led left lent lit lost made meant met mistaken overheard paid ridden risen said seen sent sewn "
    " shaken shown shrunk slept slid sold sought spent spoken spun stolen stood struck stuck sung sunk swept "
    " sworn swung taken taught thought thrown told torn understood undone unread unset withdrawn withheld "
    " woken won worn wound woven written "
)
#: words that end in -ed and are no participles
VERBS = frozenset({"feed", "need", "speed", "seed", "embed", "exceed", "proceed", "succeed", "heed", "shed"})
#: adverbs, prepositions and adjectives that said nothing of what a function did
NO_VERBS = (
    " about ahead alike alive alone along apart around away back before believable beside busy doubtful enough few "
    " finite flat impatient inside later observable off ordinary others otherwise outside own plain punctual real "
    " single somebody somewhere steady together upright urgent whole within writable wrong "
)
#: participles that, alone, do not say what a variable, parameter or field holds
EMPTY = frozenset(["told", "heard", "overheard", "said", "kept", "seen", "begun", "meant", "looked"])
#: qualified name → why it may stay
ALLOWED: dict[str, str] = {}
#: class → why it may stay
ADJECTIVES = {"Summarized": "a protocol: whatever a summary can be made of"}


def is_participle(name: str) -> bool:
    """Whether the first word of a function's name says what was done instead of what to do."""
    word = name.strip("_").split("_")[0].lower()
    return f" {word} " in IRREGULAR or (word.endswith("ed") and word not in VERBS)


def is_no_verb(name: str) -> bool:
    """Whether a function's whole name is an adverb, a preposition or an adjective."""
    return f" {name.strip('_').lower()} " in NO_VERBS


def is_value(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """A property or a fixture is read like a value: `trip.confirmed` is an adjective, and right."""
    for decorator in function.decorator_list:
        name = ast.unparse(decorator)
        values = {"property", "cached_property", "functools.cached_property"}
        if name in values or name.startswith("pytest.fixture") or name.endswith((".setter", ".deleter")):
            return True
    return False


def definitions(body: list[ast.stmt], where: str) -> Iterator[tuple[str, Definition]]:
    """(qualified name, node) of every class and function, inner ones too."""
    for node in body:
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            yield f"{where}.{node.name}", node
            yield from definitions(node.body, f"{where}.{node.name}")
        else:
            for field in ("body", "orelse", "finalbody", "handlers"):
                yield from definitions(getattr(node, field, []), where)


@cache
def parse(source: str) -> ast.Module:
    return ast.parse(source)


def names(source: str, where: str) -> list[tuple[str, Definition]]:
    return list(definitions(parse(source).body, where))


def variables(source: str, where: str) -> Iterator[tuple[str, str]]:
    """(place, name) of every parameter, variable and attribute that gets a value."""
    for node in ast.walk(parse(source)):
        if isinstance(node, ast.arg):
            yield f"{where}:{node.lineno}", node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield f"{where}:{node.lineno}", node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield f"{where}:{node.lineno}", node.attr


def empty(found: Iterable[tuple[str, str]]) -> list[str]:
    return [f"{where} {name}" for where, name in found if name.strip("_").lower() in EMPTY]


def sources(root: Path, *folders: str) -> dict[str, str]:
    """Module or file → text of every Python file in `folders`."""
    return {
        ".".join(path.relative_to(root / folder).with_suffix("").parts): path.read_text(encoding="utf-8")
        for folder in folders
        for path in sorted((root / folder).rglob("*.py"))
    }


@pytest.fixture(scope="module")
def ours(root: Path) -> list[tuple[str, Definition]]:
    return [found for module, text in sources(root, "src").items() for found in names(text, module)]


@pytest.fixture(scope="module")
def beside(root: Path) -> list[tuple[str, Definition]]:
    """Of what is run beside the package, tests included."""
    folders = ("scripts", "benchmarks", "tests")
    return [found for file, text in sources(root, *folders).items() for found in names(text, file)]


def past(found: list[tuple[str, Definition]]) -> list[str]:
    return [
        name
        for name, node in found
        if not isinstance(node, ast.ClassDef)
        and not is_value(node)
        and (is_participle(node.name) or is_no_verb(node.name))
        and name not in ALLOWED
    ]


def bare(found: list[tuple[str, Definition]]) -> list[str]:
    """Classes whose whole name is a participle: of what?"""
    return [
        name
        for name, node in found
        if isinstance(node, ast.ClassDef)
        and sum(letter.isupper() for letter in node.name) == 1
        and is_participle(node.name)
        and node.name not in ADJECTIVES
    ]


def twice(found: list[tuple[str, Definition]]) -> dict[str, list[str]]:
    places = defaultdict(list)
    for name, node in found:
        if isinstance(node, ast.ClassDef):
            places[node.name].append(name)
    return {name: where for name, where in places.items() if len(where) > 1}


def test_no_function_is_a_past_participle(ours, beside):
    assert past(ours + beside) == [], "what does something is called by a verb in the imperative: CONTRIBUTING, Names"


def test_no_class_is_a_bare_past_participle(ours, beside):
    assert bare(ours + beside) == [], "a class is called by a noun: CONTRIBUTING, Names"


def test_no_variable_is_a_participle_that_does_not_say_what_it_holds(root: Path) -> None:
    texts = sources(root, "src", "scripts", "benchmarks")
    assert [name for where, text in texts.items() for name in empty(variables(text, where))] == [], (
        "a value is called by a noun: CONTRIBUTING, Names"
    )


@pytest.mark.parametrize(
    "source",
    ["told = 1", "def f(heard): ...", "class A:\n    def f(self):\n        self._kept = 1", "for seen in (): ..."],
)
def test_empty_participles_would_be_found(source: str) -> None:
    assert len(empty(variables(source, "m"))) == 1
    assert not empty(variables("reply, received, feed = 1, 2, 3", "m"))


def test_bare_participles_of_classes_would_be_found() -> None:
    assert bare(names("class Told: ...\nclass TrackedPose: ...\nclass Feed: ...", "m")) == ["m.Told"]


def test_no_class_name_is_used_twice(ours):
    assert twice(ours) == {}, "each class has a name of its own, so that a search finds it"


def test_what_is_allowed_is_there(ours):
    there = {name for name, _ in ours}
    assert [name for name, why in ALLOWED.items() if name not in there or not why] == []
    classes = {node.name for _, node in ours}
    assert [name for name, why in ADJECTIVES.items() if name not in classes or not why] == []


@pytest.mark.parametrize(
    "name",
    [
        "told",
        "_summed",
        "kept",
        "known_rate",
        "felt_map",
        "cached_torque_table",
        "shown",
        "answered",
        "driven",
        "_alone",
        "within",
    ],
)
def test_the_old_names_would_be_found(name: str) -> None:
    assert past(names(f"def {name}(): ...", "m")) == [f"m.{name}"]
    assert past(names(f"class A:\n    async def {name}(self): ...", "m")) == [f"m.A.{name}"]


@pytest.mark.parametrize("name", ["fill_row", "check_rate", "feed", "read", "put", "seed_noise", "set_gains", "redraw"])
def test_verbs_are_let_be(name: str) -> None:
    assert past(names(f"def {name}(): ...", "m")) == []


def test_a_property_may_be_an_adjective() -> None:
    assert past(names("class A:\n    @property\n    def confirmed(self): ...", "m")) == []


def test_doubled_classes_would_be_found() -> None:
    assert twice(names("class Course: ...\nclass A:\n    class Course: ...", "m")) == {
        "Course": ["m.Course", "m.A.Course"]
    }


def test_an_earlier_public_name_still_works_and_says_what_it_is_called_now() -> None:
    with pytest.warns(DeprecationWarning, match=r"haptorb\.force_map"):
        assert haptorb.felt_map is haptorb.force_map
    assert "felt_map" not in haptorb.__all__
