"""Put the stored benchmarks (docs/benchmarks.json) into README.md: python scripts/benchmark_table.py [--check]

What stands between the two marks in README.md is replaced; with --check nothing is written, and a difference ends
with code 1.
"""

from __future__ import annotations

import sys
from pathlib import Path

from haptorb.apps.bench import load_result

ROOT = Path(__file__).resolve().parents[1]
BEGIN, END = "<!-- benchmarks: begin -->\n", "<!-- benchmarks: end -->"
#: what README shows; docs/reference/benchmarks.md has all
SHOWN = ("magnetics", "allocation", "tick", "start", "loop", "console", "recording")


def with_table(readme: str) -> str:
    """`readme` with the stored table between its marks."""
    before, _, rest = readme.partition(BEGIN)
    _, mark, after = rest.partition(END)
    if not mark:
        raise SystemExit(f"README.md lacks the marks {BEGIN.strip()} and {END}")
    return before + BEGIN + load_result(ROOT / "docs" / "benchmarks.json").markdown(SHOWN, short=True) + END + after


def main() -> int:
    """Write, or compare."""
    path = ROOT / "README.md"
    readme = path.read_text(encoding="utf-8")
    wanted = with_table(readme)
    if "--check" in sys.argv[1:]:
        return int(readme != wanted)
    path.write_text(wanted, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
