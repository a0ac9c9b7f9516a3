"""The rules that `scripts/prove_safety.py` breaks one by one must be where it looks for them."""

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROOFS = runpy.run_path(str(ROOT / "scripts" / "prove_safety.py"))["PROOFS"]


@pytest.mark.parametrize(("rule", "file", "kept", "broken", "tests"), PROOFS, ids=[proof[0] for proof in PROOFS])
def test_the_code_that_keeps_a_rule_and_its_tests_are_there(rule, file, kept, broken, tests):
    assert kept in (ROOT / "src" / "haptorb" / file).read_text(encoding="utf-8"), f"'{rule}' looks for what is gone"
    assert kept != broken
    place, _, name = tests.partition("::")  # a file, or one test of it
    assert (ROOT / place).exists(), f"'{rule}' is proved by tests that are gone"
    assert not name or f"def {name}(" in (ROOT / place).read_text(encoding="utf-8"), f"'{rule}': {name} is gone"
