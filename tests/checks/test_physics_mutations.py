"""The places that `scripts/mutate_physics.py` changes exist, and its record covers the physics."""

from __future__ import annotations

import ast
import sys
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))
script, code = import_module("mutate_physics"), import_module("code_mutations")
sys.path.remove(str(ROOT / "scripts"))
RECORD = script.read_record()
ROWS = script.flatten(RECORD["rows"])


@pytest.mark.parametrize("mutation", script.MUTATIONS, ids=lambda mutation: mutation.name)
def test_a_mutation_fits_its_file_and_turned_a_row_red(mutation) -> None:
    text = code.read_source(script.PACKAGE, mutation)
    assert ast.dump(ast.parse(code.change_code(text, mutation))) != ast.dump(ast.parse(text))
    assert RECORD["red"][mutation.name]


def test_the_record_leaves_no_file_and_no_row_open() -> None:
    assert set(RECORD["red"]) == {mutation.name for mutation in script.MUTATIONS}
    assert script.find_gaps(RECORD["red"], ROWS) == []
    assert set(script.REASONS) <= set(script.list_physics())
    # a file without a row, a row without a mutation and a mutation without a row are told
    red = {name: rows for name, rows in RECORD["red"].items() if "thermal" not in name}
    assert any("thermal.py" in gap for gap in script.find_gaps(red, ROWS))
    for verdict in script.SHOWN:
        assert script.find_gaps(RECORD["red"], {**ROWS, "bai2012 new": verdict}) == [
            f"bai2012 new: {verdict}, but no mutation turns it red"
        ]
    assert set(script.PRINT_ONLY) <= {row for row, verdict in ROWS.items() if verdict == "contradicted"}


@pytest.mark.parametrize(
    ("target", "changed"),
    [
        ("y", "y = -2 * (x + 1)"),
        ("y#1", "y = -2 * x"),
        ("a, b@elts[1]", "a, b = (x, -2 * y)"),
        ("z@args[0]", "z = max(-2 * x, y)"),
        ("d@keywords[key].value", "d = h(1, key=-2 * x)"),
        ("e@values[a b].args[0]", "e = {'c': x, 'a b': h(-2 * y)}"),
        ("out[0, 1]", "out[0, 1] += -2 * z"),
        ("key", "g(key=-2 * x)"),
        ("return", "return -2 * y"),
    ],
)
def test_how_a_target_is_found(target: str, changed: str) -> None:
    text = (
        "def f(x, out):\n    y = x + 1\n    a, b = x, y\n    z = max(x, y)\n    out[0, 1] += z\n    y = x\n"
        "    g(key=x)\n    d = h(1, key=x)\n    e = {'c': x, 'a b': h(y)}\n    return y\n"
    )
    found = code.change_code(text, code.Mutation("a.py", "f", target, -2, ()))
    assert changed in found
    assert sum(line not in ast.unparse(ast.parse(text)) for line in found.splitlines()) == 1


@pytest.mark.parametrize(
    ("function", "target"),
    [("f", "q"), ("g", "y"), ("f", "y#2"), ("f", "y@args[0]"), ("f", "y@keywords[k].value"), ("f", "y@values[k]")],
)
def test_what_is_not_there_is_told(function: str, target: str) -> None:
    with pytest.raises(code.MutationError, match=target.partition("@")[0]):
        code.change_code("def f(x):\n    y = x\n", code.Mutation("a.py", function, target, -1, ()))


def test_two_mutations_for_real(tmp_path: Path) -> None:
    """In a copy, each in a process of its own: the record is not merely a list that somebody wrote."""
    script.copy_sources(tmp_path)
    for name in ("beams.py, appendix_b: plus_1 × 1.1", "beams.py, force_ratio: angle × -1"):
        mutation = next(one for one in script.MUTATIONS if one.name == name)
        red, failed = script.find_red(mutation, tmp_path, ROWS)
        assert failed == []
        assert red == RECORD["red"][name]
