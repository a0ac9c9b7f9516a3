"""Put the stored benchmarks (docs/benchmarks.json) into README.md: python scripts/benchmark_table.py [--check]

What stands between the two marks in README.md is replaced; with --check nothing is written, and a difference ends
with code 1.
"""

from __future__ import annotations

import sys
from pathlib import Path

from haptorb_bench import load_result

ROOT = Path(__file__).resolve().parents[1]
BEGIN, END = "<!-- benchmarks: begin -->\n", "<!-- benchmarks: end -->"
#: what README shows, against the fastest peer only; docs/reference/benchmarks.md has all
SHOWN = ("magnetics", "allocation", "tick", "start", "loop", "console")


def with_table(readme: str) -> str:
    """`readme` with the stored table between its marks."""
    before, _, rest = readme.partition(BEGIN)
    _, mark, after = rest.partition(END)
    if not mark:
        raise SystemExit(f"README.md lacks the marks {BEGIN.strip()} and {END}")
    table = load_result(ROOT / "docs" / "benchmarks.json").markdown(SHOWN, short=True)
    return before + BEGIN + fastest_peers(table) + END + after


def fastest_peers(table: str) -> str:
    """`table` with one row for each task: that against the peer with the smallest ratio."""
    head, rows = table.splitlines()[:4], table.splitlines()[4:]
    least: dict[str, tuple[float, str]] = {}
    for row in rows:
        *_, ratio, _ = row.split("|")
        number = float(ratio.replace(",", "").replace("×", "") or "inf") if ratio.strip() else float("inf")
        task = row.split(" (", 1)[0].split(" |", 1)[0]
        if task not in least or number < least[task][0]:
            least[task] = (number, row)
    return "\n".join([*head, *(row for _, row in least.values())]) + "\n"


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
