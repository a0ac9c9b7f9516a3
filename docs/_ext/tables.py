"""Tables that the program itself knows: rows, trips, worlds, device keys and commands, written from the code."""

from __future__ import annotations

import io
import os
from contextlib import redirect_stdout
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

from pydantic import BaseModel
from sphinx.application import Sphinx

import haptorb
from haptorb import worlds
from haptorb.beams import MATERIALS
from haptorb.control.trips import GuardState, Trip
from haptorb.devices.base import kind_names, kind_of_name
from haptorb.devices.schema import list_keys
from haptorb.recording.row import RowLayout
from haptorb.serve.foxglove import RowMessages
from haptorb.serve.osc import INCOMING, OUTGOING, REPLIES
from haptorb.worlds.base import parameters
from haptorb_design.design_file import DeviceDesignFile
from haptorb_design.objectives import quantity, quantity_names
from haptorb_study.feel.designs import DesignFile, DesignTable
from haptorb_study.study_file import Study
from haptorb_study.template import TEMPLATES, make_study_text


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
        devices = " For devices that move a target (motors)." if world.needs_target else ""
        parts.append(
            f"## {name}\n\n{first} Declared {' and '.join(traits)}.{asks}{devices} "
            f"Class `{world.__module__}.{world.__name__}`.\n"
        )
        rows = [
            (f"`{p.name}`", p.default, f"{p.low:g} to {p.high:g}", p.unit, p.about) for p in parameters(world).values()
        ]
        if rows:
            parts.append(table(("parameter", "default", "range", "unit", "meaning"), rows))
    return "\n".join(parts)


def _key_table(model: type[BaseModel], prefix: str = "") -> str:
    """Every key of a file as a row."""
    head = ("key", "meaning", "value", "unit", "range", "default")
    rows = [
        (f"`{key.path}`", key.meaning, key.value, key.unit, key.range.replace("<", "\\<"), key.default)
        for key in list_keys(model, prefix)
    ]
    return table(head, rows)


def device_keys() -> str:
    """Every key of every kind of device file."""
    return "\n".join(f'### kind = "{name}"\n\n{_key_table(kind_of_name(name).part("file"))}' for name in kind_names())


def study_keys() -> str:
    """Every key of a study file."""
    return _key_table(Study)


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
            f"## The file\n\n{_key_table(DesignFile)}",
            f"## [common] and each [design.NAME]\n\n{_key_table(DesignTable, 'design.NAME.')}",
            f"## Known materials\n\nOne grade each, for a first comparison of designs. Sources:\n\n{sources}\n",
            table(heads, rows),
        ]
    )


def device_design_keys() -> str:
    """Every key of a design file."""
    tables = _key_table(DeviceDesignFile)
    for name in ("parameters", "objectives", "constraints"):
        tables = tables.replace(f"`{name}.", f"`{name}.NAME.")
    return tables


def design_quantities() -> str:
    """What can be an objective or a constraint of a design."""
    rows = [
        (f"`{one.name}`", one.unit or "1", one.sense, ", ".join(one.kinds), one.text)
        for one in map(quantity, quantity_names())
    ]
    return table(("quantity", "unit", "sense", "kinds of device", "meaning"), rows)


def command_line() -> str:
    """What the commands say of themselves, in a terminal of 86 columns; a process for each would take a second."""
    from typer.main import get_command

    command: Any = get_command(import_module("haptorb.cli.program").app)
    environment = {"COLUMNS": "86", "NO_COLOR": "1", "TERM": "dumb", "HOME": str(Path.home())}

    def told(*words: str) -> str:
        with patch.dict(os.environ, environment, clear=True), redirect_stdout(io.StringIO()) as said:
            command.main([*words, "--help"], prog_name="haptorb", standalone_mode=False)
        return "\n".join(line.rstrip() for line in said.getvalue().strip("\n").splitlines())

    names = sorted(name for name, one in getattr(command, "commands", {}).items() if not one.hidden)
    parts = [f"```text\n{told()}\n```\n"]
    parts += [f"## haptorb {name}\n\n```text\n{told(name)}\n```\n" for name in names]
    return "\n".join(parts)


def benchmarks() -> str:
    """The stored figures of `haptorb bench`."""
    from haptorb_bench import load_result

    return load_result(Path(__file__).resolve().parents[1] / "benchmarks.json").markdown()


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


PAGES = {
    "osc-messages": osc_messages,
    "foxglove-topics": foxglove_topics,
    "benchmarks": benchmarks,
    "row-table": row_table,
    "trip-table": trip_table,
    "world-table": world_table,
    "device-keys": device_keys,
    "study-keys": study_keys,
    "study-templates": study_templates,
    "design-keys": design_keys,
    "device-design-keys": device_design_keys,
    "design-quantities": design_quantities,
    "command-line": command_line,
}


def _write(app: Sphinx) -> None:
    folder = Path(app.srcdir) / "reference" / "generated"
    folder.mkdir(parents=True, exist_ok=True)
    for name, made in PAGES.items():
        page, text = folder / f"{name}.md", made()
        if not page.exists() or page.read_text() != text:
            page.write_text(text)


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the tables before Sphinx looks for them."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True}
