"""Change one factor or sign of the physics and check that rows fail: `python scripts/mutate_physics.py [WORD…]`.

With words: only the mutations in whose name one of them stands. A row of `haptorb reproduce` that cannot turn red shows
nothing. So each mutation of `physics_mutations.MUTATIONS` is made in a copy of the sources, and the rows are computed
anew in a process of its own, with a cache of its own: kernels and tables are named after the sources that make them, so
a changed formula meets neither a compiled one nor a stored table. The record of which rows went red is kept beside this
file (`--write`); without that option the run is compared with it. The exit code is the number of mutations that no row
notices, of files of the physics without a mutation or a reason, and of rows of SHOWN that no
mutation turns red, but for those that compute with what is printed alone (`PRINT_ONLY`).

What no printed number stands on is compared with another computation by tests: a part of a mutation may be a test, and
each case of it is a row.

`--slow` adds the rows that take minutes.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from itertools import count
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from code_mutations import Mutation, change_code, read_source
from physics_mutations import MUTATIONS, PRINT_ONLY, REASONS, SLOW

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "src" / "haptorb"
RECORD = Path(__file__).with_name("physics_mutations.json")
_SECONDS = count(1_000_000_000)  #: times of sources
CHECKED = "checked"  #: the class of a test that passes
SHOWN = ("reproduced", "implied", "set and found", "contradicted", CHECKED)  #: of rows that must be able to turn red

_COMPUTE = """
import json, sys
from haptorb_papers.reproduce import find_reproduction
found = {}
for part in json.loads(sys.argv[1]):
    paper, _, name = part.partition(" ")
    try:
        rows, _ = find_reproduction(paper, name).make()
    except Exception as failure:
        found[part] = repr(failure)
    else:
        found[part] = {f"{row.paper} {row.id}": row.verdict for row in rows}
print(json.dumps(found))
"""


def compute_rows(parts: tuple[str, ...], source: Path, cache: Path) -> dict[str, dict[str, str] | str]:
    """Part → its rows' verdicts, or what it failed with; in new processes that import haptorb from `source`."""
    path = os.pathsep.join((str(source), str(source.parent / "papers")))
    environment = {**os.environ, "PYTHONPATH": path, "XDG_CACHE_HOME": str(cache)}
    environment.pop("NUMBA_CACHE_DIR", None)
    found: dict[str, dict[str, str] | str] = {}
    tests = [part for part in parts if part.startswith("tests/")]
    if printed := [part for part in parts if part not in tests]:
        run = _run(["-c", _COMPUTE, json.dumps(printed)], source, environment)
        found = (
            dict.fromkeys(printed, run.stderr.strip().splitlines()[-1])
            if run.returncode
            else json.loads(run.stdout.splitlines()[-1])
        )
    for test in tests:
        run = _run(["-m", "pytest", "-q", "-p", "no:cacheprovider", "--tb=no", "-rpfE", test], ROOT, environment)
        cases = re.findall(r"^(PASSED|FAILED|ERROR) (.+?)(?: - .*)?$", run.stdout, re.MULTILINE)
        found[test] = {row: CHECKED if outcome == "PASSED" else outcome.lower() for outcome, row in cases} or (
            (run.stdout + run.stderr).strip().splitlines() or ["no output"]
        )[-1]
    return found


def _run(words: list[str], folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def find_red(mutation: Mutation, folder: Path, sound: dict[str, str]) -> tuple[list[str], list[str]]:
    """Rows that `mutation` turns from a class of SHOWN into another, and parts that failed instead of computing.

    `folder` holds `src`, a copy of the sources, and `cache`; `sound` are the verdicts without any mutation.
    """
    path = folder / "src" / "haptorb" / mutation.file
    text = read_source(PACKAGE, mutation)
    _write_anew(path, change_code(text, mutation))
    try:
        found = compute_rows(mutation.parts, folder / "src", folder / "cache")
    finally:
        _write_anew(path, text)
    red, failed = [], []
    for part, rows in found.items():
        if isinstance(rows, str):
            failed.append(f"{part}: {rows}")
            continue
        red += [row for row, verdict in rows.items() if sound.get(row) in SHOWN and verdict != sound[row]]
    return sorted(red), failed


def _write_anew(path: Path, text: str) -> None:
    """Write `text` with a time that no earlier one had: byte code is known by the second and the size of its source."""
    path.write_text(text, encoding="utf-8")
    second = next(_SECONDS)
    os.utime(path, (second, second))


def copy_sources(folder: Path) -> None:
    """A copy of the packages' sources below `folder`."""
    for name in ("src", "papers"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))


def list_physics() -> list[str]:
    """The physics files, below src/haptorb; those that only name the others are left out."""
    files = [path for path in (PACKAGE / "magnetics").rglob("*.py") if path.name != "__init__.py"]
    files += [PACKAGE / "beams.py", PACKAGE / "thermal.py"]
    return sorted(str(path.relative_to(PACKAGE)) for path in files)


def find_gaps(record: dict[str, list[str]], sound: dict[str, str]) -> list[str]:
    """What the record leaves open: files, mutations and rows, one sentence each."""
    mutated = {mutation.file: [] for mutation in MUTATIONS}
    for mutation in MUTATIONS:
        mutated[mutation.file] += record.get(mutation.name, [])
    gaps = [f"{mutation.name}: no row turns red" for mutation in MUTATIONS if not record.get(mutation.name)]
    for file in list_physics():
        shown = [row for row in mutated.get(file, []) if sound.get(row) in ("reproduced", "implied", CHECKED)]
        if not shown and file not in REASONS:
            gaps.append(f"{file}: no reproduced or checked row turns red by a change of it")
    red = {row for rows in record.values() for row in rows}
    gaps += [
        f"{row}: {verdict}, but no mutation turns it red"
        for row, verdict in sound.items()
        if row not in red and row not in PRINT_ONLY
    ]
    gaps += [f"{row}: has a reason, but a mutation turns it red" for row in PRINT_ONLY if row in red]
    return gaps


def read_record() -> dict[str, dict[str, Any]]:
    """`rows`: by part, its rows of SHOWN and their classes; `red`: by mutation, the rows that it turns red."""
    return json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.exists() else {"rows": {}, "red": {}}


def flatten(rows: dict[str, dict[str, str]]) -> dict[str, str]:
    """Row → class, of all parts."""
    return {row: verdict for part in rows.values() for row, verdict in part.items()}


def write_record(rows: dict[str, dict[str, str]], red: dict[str, list[str]]) -> None:
    """Put `rows` and `red` into the record; what it has of mutations that are gone is left out."""
    before = read_record()
    every = {**before["red"], **red}
    ordered = {one.name: every[one.name] for one in MUTATIONS if one.name in every}
    rows = dict(sorted({**before["rows"], **rows}.items()))
    RECORD.write_text(json.dumps({"rows": rows, "red": ordered}, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def main() -> int:
    """Try the chosen mutations, tell what turned red, and compare with the record or write it."""
    options = {word for word in sys.argv[1:] if word.startswith("--")}
    words = [word for word in sys.argv[1:] if word not in options]
    if unknown := options - {"--write", "--slow"}:
        sys.exit(f"there is no option {', '.join(sorted(unknown))}; there are --write and --slow")
    chosen = [one for one in MUTATIONS if not words or any(word in one.name for word in words)]
    chosen = [one for one in chosen if "--slow" in options or not SLOW & set(one.parts)]
    if not chosen:
        sys.exit(f"no mutation has {' or '.join(map(repr, words))} in its name")
    before = read_record()
    record = {one.name: before["red"].get(one.name, []) for one in MUTATIONS}
    wrong = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        copy_sources(folder)
        parts = tuple(sorted({part for one in chosen for part in one.parts}))
        rows = dict(before["rows"])
        for part, found in compute_rows(parts, folder / "src", folder / "cache").items():
            if isinstance(found, str):
                sys.exit(f"{part} fails without any mutation: {found}")
            rows[part] = {row: verdict for row, verdict in found.items() if verdict in SHOWN}
        sound = flatten(rows)
        for mutation in chosen:
            red, failed = find_red(mutation, folder, sound)
            if red != record[mutation.name] and "--write" not in options:
                wrong.append(f"{mutation.name}: the record has {', '.join(record[mutation.name]) or 'nothing'}")
            record[mutation.name] = red
            print(f"{len(red):3} red  {mutation.name}: {', '.join(red) or '-'}", flush=True)
            for failure in failed:
                print(f"     failed, which counts for nothing: {failure}", flush=True)
            if "--write" in options:
                write_record({part: rows[part] for part in parts}, {mutation.name: red})
    wrong += find_gaps(record, sound)
    for sentence in wrong:
        print(sentence)
    print(f"{len(chosen)} mutations tried, {len(wrong)} gaps")
    return min(len(wrong), 99)


if __name__ == "__main__":
    sys.exit(main())
