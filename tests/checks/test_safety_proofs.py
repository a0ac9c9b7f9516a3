"""The rules that `scripts/prove_safety.py` breaks one by one exist in the code."""

from __future__ import annotations

import ast
import re
import sys
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))
script, markers, promised = map(import_module, ("prove_safety", "safety_markers", "prove_promises"))
sys.path.remove(str(ROOT / "scripts"))


@pytest.fixture(scope="module")
def proofs():
    """All proofs by their markers: not made while tests are collected, because every process collects them."""
    found = script.collect_proofs(script.RULES, markers.find_marked(script.PACKAGE))
    return {proof.marker: proof for proof in found}


@pytest.mark.parametrize("marker", [marker for marker, *_ in script.RULES])
def test_a_rule_can_be_broken_and_its_tests_are_there(proofs, marker):
    proof = proofs[marker]
    assert proof.broken != proof.path.read_text(encoding="utf-8")
    place, _, name = proof.tests.partition("[")[0].partition("::")  # a file, or one test of it
    assert (ROOT / place).exists(), f"'{proof.rule}' is proved by tests that are gone"
    text = (ROOT / place).read_text(encoding="utf-8")
    before, found, _ = text.partition(f"def {name}(")
    assert not name or found, f"'{proof.rule}': {name} is gone"
    nightly = re.search(r"^pytestmark = .*mark\.slow", text, re.MULTILINE) or (
        name and "@pytest.mark.slow" in before.rpartition("\n\n\n")[2]
    )
    assert not nightly, f"'{proof.rule}' is proved in the nightly run only"


def mark(folder: Path, text: str) -> dict[str, object]:
    (folder / "code.py").write_text(text, encoding="utf-8")
    return markers.find_marked(folder)


@pytest.mark.parametrize(
    ("kept", "mutation", "broken"),
    [
        ("µ(a)  # safety: x", "drop", "pass"),
        ("'# safety: y'; a = b  # safety: x", "drop", "pass; a = b"),  # a text is no marker
        ("# safety: x\n# why\na = b", "drop", "pass"),
        ("def f():\n    wait(a)  # safety: x\n    return 1", "return", "def f():\n    return\n    return 1"),
        ("if 'µ' and a:  # safety: x\n    b", "never", "if False:\n    b"),
        ("if a:\n    b\nelif c:  # safety: x\n    d", "always", "if a:\n    b\nelif True:\n    d"),
        ("if a:\n    b\nelif c:  # safety: x\n    d", "drop", "if a:\n    b\npass"),
        ("while a:  # safety: x\n    b if c else d", "never", "while False:\n    b if c else d"),
        ("a = f(b if c else d)  # safety: x", "never", "a = f(b if False else d)"),
        ("try:\n    a\nexcept B as b:  # safety: x\n    c", "uncaught", "try:\n    a\nexcept () as b:\n    c"),
        (
            "try:\n    a\n# safety: x\nexcept B:\n    c",
            "replace type by OSError",
            "try:\n    a\nexcept OSError:\n    c",
        ),
        ("if not (a and b or c):  # safety: x\n    d", "only 1", "if not (a and b):\n    d"),
        ("a = f(b and c and d)  # safety: x", "without 2", "a = f(b and d)"),
        ("a = min(b + c, d) * e  # safety: x", "only 1", "a = (b + c) * e"),
        ("f(a, k=b)  # safety: x", "without 1", "f(k=b)"),
        ("f(\n    a,  # safety: x\n)", "without 1", "f()"),
        ("f(g([a, b, c]))  # safety: x", "without 2 of value.args[0].args[0]", "f(g([a, c]))"),
        ("f(a, b & c)  # safety: x", "only 1 of value.args[1]", "f(a, b)"),
        ("a = b = 0  # safety: x", "replace . by {targets[1]}, {targets[0]} = {value}, 1", "b, a = 0, 1"),
        ("if a or b:  # safety: x\n    c", "replace test by {test} and 1", "if (a or b) and 1:\n    c"),
    ],
)
def test_a_marked_statement_is_broken_as_said(tmp_path, kept, mutation, broken):
    found = markers.break_code(mark(tmp_path, kept)["x"], mutation)
    assert ast.unparse(ast.parse(found)) == ast.unparse(ast.parse(broken))


def test_two_rules_may_be_kept_by_one_statement(tmp_path):
    found = mark(tmp_path, "if a:  # why  # safety: one, two-more\n    b  # safety: three")
    assert [ast.unparse(marked.node) for marked in found.values()] == ["if a:\n    b"] * 2 + ["b"]


@pytest.mark.parametrize(
    ("text", "mistake"),
    [
        ("a  # safety: x\nb  # safety: x", "two statements are marked 'x'"),
        ("a  # safety: X", "a marker ends with its names"),
        ("a  # safety: x because", "a marker ends with its names"),
        ("a\n# safety: x", "no statement is marked"),
    ],
)
def test_markers_that_mark_nothing_or_twice_are_refused(tmp_path, text, mistake):
    with pytest.raises(markers.MarkerError, match=mistake):
        mark(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "mutation", "mistake"),
    [
        ("pass  # safety: x", "drop", "leaves `pass`"),
        ("while True:  # safety: x\n    a", "always", "leaves `while True:"),
        ("a = b  # safety: x", "never", "does not fit"),
        ("a = b and c  # safety: x", "only 3", "does not fit"),
        ("a = b  # safety: x", "uncaught", "does not fit"),
        ("a = b  # safety: x", "replace value by )", "makes no Python"),
        ("a = b  # safety: x", "break it", "there is no mutation"),
        ("a = b  # safety: x", "replace value+1 by 2", "is no path"),
    ],
)
def test_a_mutation_that_does_not_fit_or_changes_nothing_is_refused(tmp_path, text, mutation, mistake):
    with pytest.raises(markers.MarkerError, match=mistake):
        markers.break_code(mark(tmp_path, text)["x"], mutation)


@pytest.mark.parametrize(
    ("names", "mistake"),
    [("x", "no rule in .*: y "), ("xyz", "no statement in .* is marked `# safety: z`"), ("xyx", "more than one rule")],
)
def test_each_marker_has_one_rule_and_each_rule_a_marker(tmp_path, names, mistake):
    marked = mark(tmp_path, "a  # safety: x\nb  # safety: y")
    with pytest.raises(markers.MarkerError, match=mistake):
        script.collect_proofs([(name, "a rule", "drop", "a test") for name in names], marked)


def test_every_promise_is_broken_once_with_each_of_its_commands():
    promises = promised.read_promises(promised.TABLE.read_text(encoding="utf-8"))
    assert len(promises) > 30
    assert promised.find_gaps(promises, promised.BREAKS) == []


@pytest.mark.parametrize("one", promised.BREAKS, ids=lambda one: f"{one.row}, {one.command}")
def test_what_breaks_a_promise_fits_the_code(one):
    path, broken = promised.break_code_of(ROOT, one.change)
    assert broken != path.read_text(encoding="utf-8")


def test_a_promise_that_nothing_breaks_is_found():
    rows = {"A is kept": ["pytest a", "pytest b"], "B is kept": ["pytest c"]}
    gaps = promised.find_gaps(rows, (promised.Break("A is", "pytest a", "x"), promised.Break("C", "pytest c", "x")))
    assert [("pytest b" in gap, "pytest c" in gap, "'C'" in gap) for gap in gaps] == [
        (True, False, False),
        (False, True, False),
        (False, False, True),
    ]
