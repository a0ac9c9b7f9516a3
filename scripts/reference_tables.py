"""Write generated tables into README.md and docs: keys, commands, addresses, rows, trips, worlds, benchmarks.

usage: python scripts/reference_tables.py [--check]

The text between `<!-- NAME: begin -->` and `<!-- NAME: end -->` is replaced, so that every page can be read where it
is: in a clone, on a forge, in the wheel. With --check nothing is written; a page that differs is named, and the exit
code is 1.
"""

from __future__ import annotations

import io
import os
import re
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any
from unittest.mock import patch

from typer.main import get_command

import haptorb
from haptorb import worlds
from haptorb.beams import MATERIALS
from haptorb.cli.keys import FILES
from haptorb.cli.program import app
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.schema import KeyText
from haptorb.recording.row import RowLayout
from haptorb.serve.foxglove import RowMessages
from haptorb.serve.osc import INCOMING, OUTGOING, REPLIES
from haptorb.worlds.base import parameters
from haptorb_bench import load_result
from haptorb_design.objectives import quantity, quantity_names
from haptorb_study.template import TEMPLATES, make_study_text

ROOT = Path(__file__).resolve().parents[1]


def table(head: tuple[str, ...], rows: list[tuple[Any, ...]]) -> str:
    """A Markdown table."""
    cells = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in row) + " |" for row in cells) + "\n"


def row_table() -> str:
    """The fields of a row, for Omni."""
    layout = RowLayout.of(haptorb.load("omni"))
    rows = [(f"`{field.name}`", field.width, field.unit, field.about) for field in layout.fields]
    return table(("field", "numbers", "unit", "meaning"), rows)


def trip_table() -> str:
    """States and reasons, with their codes."""
    states = table(("code", "state"), [(state.value, state.name.lower()) for state in GuardState])
    reasons = [(trip.value, trip.name.lower().replace("_", " "), trip.text) for trip in Trip]
    return states + "\n" + table(("code", "reason", "message"), reasons)


def world_table() -> str:
    """Every world of the catalogue with its parameters."""
    parts = []
    for name, world in sorted(worlds.CATALOGUE.items()):
        first = (world.__doc__ or "").strip().splitlines()[0]
        traits = ("passive" if world.passive else "active", "continuous" if world.continuous else "with jumps")
        asks = "" if world.asks is None else f" Asks {world.asks.replace('both', 'force and torque')}."
        if world.remembers:
            fields = ", ".join(f"{one.name} [{one.unit}]" for one in world().memory_fields)
            first += f" It remembers: {fields}."
        devices = " For devices that move an object (motors)." if world.needs_object else ""
        parts.append(
            f"## {name}\n\n{first} Declared {' and '.join(traits)}.{asks}{devices} "
            f"Class `haptorb.worlds.{world.__name__}`.\n"
        )
        rows = [
            (f"`{p.name}`", p.default, f"{p.low:g} to {p.high:g}", p.unit, p.about) for p in parameters(world).values()
        ]
        if rows:
            parts.append(table(("parameter", "default", "range", "unit", "meaning"), rows))
    return "\n".join(parts)


def _key_table(keys: tuple[KeyText, ...]) -> str:
    """Every key of a file as a row."""
    head = ("key", "meaning", "value", "unit", "range", "default")
    rows = [
        (f"`{key.path}`", key.meaning, key.value, key.unit, key.range.replace("<", "\\<"), key.default) for key in keys
    ]
    return table(head, rows)


def device_keys() -> str:
    """Every key of every kind of device file."""
    return "\n".join(f"### {title}\n\n{_key_table(keys)}" for title, keys in FILES["device"].list_sections())


def mapping_keys() -> str:
    """Every key of a mapping file."""
    return _key_table(FILES["mapping"].list_sections()[0].keys)


def study_keys() -> str:
    """Every key of a study file."""
    return _key_table(FILES["study"].list_sections()[0].keys)


def study_templates() -> str:
    """What `haptorb study new NAME --like ...` writes."""
    return "\n".join(f"### {like}\n\n```toml\n{make_study_text('mine', like)}```\n" for like in TEMPLATES)


def design_keys() -> str:
    """Every key of a file of snap-fit designs, of one design and of the known materials."""
    rows = [
        (
            name, m.condition, f"{m.youngs_modulus / 1e9:g}", f"{m.poisson_ratio:g}", f"{m.yield_strength / 1e6:g}",
            f"{100 * m.permissible_strain:.2g}", f"{100 * m.repeated_strain:.2g}", f"{100 * m.breaking_strain:g}",
        )
        for name, m in MATERIALS.items()
    ]  # fmt: skip
    heads = ("material", "condition", "E [GPa]", "ν", "yield [MPa]", "strain once [%]", "strain often [%]", "break [%]")
    sources = "\n".join(
        f"- {', '.join(name for name, m in MATERIALS.items() if m.source == source)}: {source}."
        for source in dict.fromkeys(m.source for m in MATERIALS.values())
    )
    return "\n".join(
        [
            *(f"## {title}\n\n{_key_table(keys)}" for title, keys in FILES["feel"].list_sections()),
            f"## Known materials\n\nOne grade each, for a first comparison of designs. Sources:\n\n{sources}\n",
            table(heads, rows),
        ]
    )


def device_design_keys() -> str:
    """Every key of a design file."""
    return _key_table(FILES["design"].list_sections()[0].keys)


def design_quantities() -> str:
    """What can be an objective or a constraint of a design."""
    rows = [
        (f"`{one.name}`", one.unit or "1", one.sense, ", ".join(one.kinds), one.text)
        for one in map(quantity, quantity_names())
    ]
    return table(("quantity", "unit", "sense", "kinds of device", "meaning"), rows)


def command_line() -> str:
    """What the commands say of themselves, in a terminal of 86 columns; a process for each would take a second."""
    command: Any = get_command(app)
    environment = {"COLUMNS": "86", "NO_COLOR": "1", "TERM": "dumb", "HOME": str(Path.home())}

    def told(*words: str) -> str:
        with patch.dict(os.environ, environment, clear=True), redirect_stdout(io.StringIO()) as said:
            command.main([*words, "--help"], prog_name="haptorb", standalone_mode=False)
        return "\n".join(line.rstrip() for line in said.getvalue().strip("\n").splitlines())

    def describe(words: tuple[str, ...], known: Any) -> Iterator[str]:
        """The help of the command of these words, and of the commands below it."""
        head = f"#{'#' * len(words)} haptorb {' '.join(words)}\n\n" if words else ""
        yield f"{head}```text\n{told(*words)}\n```\n"
        for name, one in sorted(getattr(known, "commands", {}).items()):
            if not one.hidden:
                yield from describe((*words, name), one)

    return "\n".join(describe((), command))


#: what README shows, against the fastest peer only; docs/reference/benchmarks.md has all
_IN_README = ("magnetics", "allocation", "tick", "start", "loop", "console")


def benchmarks() -> str:
    """The stored figures of `haptorb bench`."""
    return load_result(ROOT / "docs" / "benchmarks.json").markdown()


def benchmarks_in_short() -> str:
    """The stored figures for README: one row for each task, that against the peer with the smallest ratio."""
    shown = load_result(ROOT / "docs" / "benchmarks.json").markdown(_IN_README, short=True).splitlines()
    least: dict[str, tuple[float, str]] = {}
    for row in shown[4:]:
        *_, ratio, _ = row.split("|")
        number = float(ratio.replace(",", "").replace("×", "") or "inf") if ratio.strip() else float("inf")
        task = row.split(" (", 1)[0].split(" |", 1)[0]
        if task not in least or number < least[task][0]:
            least[task] = (number, row)
    return "\n".join([*shown[:4], *(row for _, row in least.values())]) + "\n"


def osc_messages() -> str:
    """What `--serve osc` sends, understands and answers."""
    sent = [(f"`{one.address}`", one.values, one.unit, one.about) for one in OUTGOING]
    heard = [(f"`{one.address}`", one.values, one.unit, one.about) for one in INCOMING]
    answers = [(f"`{one.address}`", one.values, one.unit, one.about) for one in REPLIES]
    head = ("values", "unit", "meaning")
    parts = [table((name, *head), rows) for name, rows in (("sent", sent), ("understood", heard), ("answer", answers))]
    return "\n".join(parts)


def foxglove_topics() -> str:
    """What `--serve foxglove` sends, and how often."""
    device = haptorb.load("omni")
    topics = RowMessages(device, RowLayout.of(device)).topics
    rows = [(f"`{one.topic.name}`", one.topic.schema_name, f"{one.rate:g}", one.about) for one in topics]
    rows += [
        ("`/shape`", "foxglove.SceneUpdate", "once", "every part of the device whose place is known"),
        (
            "`/log`",
            "foxglove.Log",
            "as it happens",
            "trips, states of the guard, changes of the world; at first the last 50",
        ),
    ]
    return table(("topic", "schema", "a second", "content"), rows)


TABLES = {
    "osc-messages": osc_messages,
    "foxglove-topics": foxglove_topics,
    "benchmarks": benchmarks,
    "benchmarks-in-short": benchmarks_in_short,
    "row-table": row_table,
    "trip-table": trip_table,
    "world-table": world_table,
    "device-keys": device_keys,
    "mapping-keys": mapping_keys,
    "study-keys": study_keys,
    "study-templates": study_templates,
    "design-keys": design_keys,
    "device-design-keys": device_design_keys,
    "design-quantities": design_quantities,
    "command-line": command_line,
}
_MARKED = re.compile(r"(<!-- ([\w./-]+): begin -->\n).*?(<!-- \2: end -->)", re.DOTALL)


def list_contents(folder: str) -> str:
    """A link to every page of a folder of the documentation."""
    titles = {path.name: path.read_text(encoding="utf-8").partition("# ")[2].partition("\n")[0]
              for path in sorted((ROOT / "docs" / folder).glob("*.md")) if path.name != "index.md"}  # fmt: skip
    return "".join(f"- [{title}]({name})\n" for name, title in titles.items())


def quote_file(name: str) -> str:
    """A file of the repository as a block of code."""
    language = {".py": "py", ".html": "html"}[Path(name).suffix]
    return f"```{language}\n{(ROOT / name).read_text(encoding='utf-8')}```\n"


def write_part(name: str) -> str:
    """What stands between the marks with this name: a table, the contents of a folder, or a file."""
    if name in TABLES:
        return TABLES[name]()
    return quote_file(name) if "." in name else list_contents(name.removeprefix("contents-"))


def find_pages() -> Iterator[Path]:
    """README and every page of the documentation."""
    yield ROOT / "README.md"
    yield from sorted(path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts)


def fill_page(text: str) -> str:
    """`text` with what the program knows now between its marks."""
    return _MARKED.sub(lambda found: f"{found[1]}\n{write_part(found[2])}\n{found[3]}", text)


def main() -> int:
    """Write, or compare."""
    differ = []
    for path in find_pages():
        text = path.read_text(encoding="utf-8")
        if (filled := fill_page(text)) != text:
            differ.append(str(path.relative_to(ROOT)))
            if "--check" not in sys.argv[1:]:
                path.write_text(filled, encoding="utf-8")
    if differ:
        print(("differs: " if "--check" in sys.argv[1:] else "written: ") + ", ".join(differ))
    return int("--check" in sys.argv[1:] and bool(differ))


if __name__ == "__main__":
    sys.exit(main())
