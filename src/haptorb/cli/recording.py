"""`haptorb info` and `export`: summarise a recording, and write its values for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from haptorb.errors import InputError, RecordingError, UnknownName
from haptorb.terminal import (
    Column,
    TextTable,
    echo,
    make_console,
    make_progress,
    notify,
    print_facts,
    print_json,
    print_table,
    print_text,
)

if TYPE_CHECKING:
    from haptorb.recording.recording import Recording

__all__ = ["check_rows", "list_missing", "parse_time", "register", "report_end"]


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""
    app.command()(info)
    app.command()(export)


def info(
    file: Annotated[Path, typer.Argument(help="Recording: an MCAP file of `haptorb run --record`.")],
    whole: Annotated[
        bool,
        typer.Option("--all", help="Compute the largest values over all ticks of a long recording (above 32 MiB) too."),
    ] = False,
    fields: Annotated[bool, typer.Option("--fields", help="List the fields with width, unit and meaning.")] = False,
    repair: Annotated[
        Path | None,
        typer.Option(metavar="OUT", help="Write all rows and notes that can be read to OUT, a whole MCAP file."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Let --repair overwrite an existing file.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Summarise a recording: device, worlds, length, largest force, lost ticks, damage."""
    from haptorb.recording.recording import Recording, list_losses
    from haptorb.recording.repair import check_place, repair_recording

    if repair is not None:
        check_place(file, repair, overwrite=force)
    recording = Recording(file)
    whole = whole or not recording.long
    if repair is not None or whole:
        check_rows(recording, show=not json)
    report_end(recording)
    if repair is not None:
        with make_progress(show=not json) as bar:
            task = bar.add_task("writing", total=1.0)
            repair_recording(recording, repair, lambda share: bar.update(task, completed=share), overwrite=force)
        if json:
            print_json({**_numbers(recording, whole), "written": str(repair)})
        else:
            losses = "; ".join(list_losses(recording)) or "nothing was missing"
            echo(f"{repair}: {len(recording)} rows; {losses}")
        return
    if json:
        print_json(_numbers(recording, whole))
        return
    console = make_console()
    if fields:
        table = TextTable((Column("field", kind="key"), Column("width", kind="short"), Column("unit", kind="short"),
                           Column("meaning", kind="text")))  # fmt: skip
        for field in recording.fields:
            table.add_row(field.name, str(field.width), field.unit.removeprefix("1"), field.about)
        print_table(console, table)
        return
    from haptorb.recording.recording import list_facts

    print_facts(console, list_facts(recording, whole=whole))
    if not whole:
        print_text(console, "Largest values and trips of a long recording: haptorb info --all", "dim")
    for error in recording.errors:
        print_text(console, f"error at tick {error.get('tick', '?')}: {error.get('text', '')}")


def check_rows(recording: Recording, *, show: bool) -> None:
    """Compare all rows of a long recording with their checksums, and leave out those that are damaged."""
    if recording.checked:
        return
    with make_progress(show=show) as bar:
        task = bar.add_task("checking", total=1.0)
        recording.check(report=lambda share: bar.update(task, completed=share))


def list_missing(recording: Recording) -> dict[str, Any]:
    """Return the rows and notes that are missing through damage or a cut, as JSON; `rows_missing` null: unknown."""
    counts = [one.rows for one in recording.missing]
    first = float(recording["t"][0]) if len(recording) and "t" in {one.name for one in recording.fields} else 0.0
    return {
        "truncated": recording.truncated,
        "checked": recording.checked,
        "rows_missing": None if None in counts else sum(n for n in counts if n is not None),
        "missing": [
            {
                "after_row": one.row,
                "rows": one.rows,
                "start_s": None if one.start is None else one.start - first,
                "end_s": None if one.end is None else one.end - first,
            }
            for one in recording.missing
        ],
        "damage": list(recording.damage),
    }


def report_end(recording: Recording) -> None:
    """Report a missing end on standard error; other damage is reported wherever a recording is opened."""
    from haptorb.recording.recording import list_losses

    if recording.truncated:
        notify(f"{recording.path}: {list_losses(recording)[-1]}")


def _numbers(recording: Recording, whole: bool) -> dict[str, Any]:
    from haptorb.recording.recording import duration_of, measure_run

    device, run = recording.metadata.get("device", {}), recording.metadata.get("run", {})
    try:
        lost: int | None = recording.lost
    except RecordingError:
        lost = None
    return {
        "file": str(recording.path),
        "bytes": recording.path.stat().st_size,
        "complete": not (recording.truncated or recording.damage),
        **list_missing(recording),
        "repair": recording.metadata.get("repair"),
        "device": device.get("name", ""),
        "digest": device.get("digest", ""),
        "driver": run.get("driver", ""),
        "model": run.get("model", ""),
        "rate_hz": _parse_number(run.get("rate_hz", "")),
        "ticks": len(recording),
        "ticks_lost": lost,
        "duration_s": duration_of(recording),
        "versions": recording.metadata.get("versions", {}),
        "worlds": [{"tick": one.get("tick", ""), "world": one.get("world", "")} for one in recording.worlds],
        "programs": [
            {key: one.get(key, "") for key in ("server", "name", "session", "start_s", "end_s", "end")}
            for one in recording.programs
        ],
        "errors": [{"tick": one.get("tick", ""), "text": one.get("text", "")} for one in recording.errors],
        "fields": [
            {"name": one.name, "width": one.width, "unit": one.unit, "about": one.about} for one in recording.fields
        ],
        "run": measure_run(recording) if whole and len(recording) else None,
    }


def _parse_number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def export(
    file: Annotated[Path, typer.Argument(help="Recording: an MCAP file of `haptorb run --record`.")],
    to: Annotated[str, typer.Option(help="Format: csv, parquet or npz.")] = "csv",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File to write (default: FILE with its suffix).")
    ] = None,
    start: Annotated[
        str | None, typer.Option(help='Start, as time after the first tick, such as "2.5 s" (default: first tick).')
    ] = None,
    end: Annotated[
        str | None, typer.Option(help='End, as time after the first tick, such as "10 s" (default: last tick).')
    ] = None,
    fields: Annotated[
        str | None,
        typer.Option(
            help="Fields, separated by commas: t,p,wrench_commanded (default: all; haptorb info --fields lists them)."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Write a recording as CSV, Parquet or NumPy arrays, with units: all of it, a range of time, or some fields."""
    from haptorb.recording.export import FORMATS, Export
    from haptorb.recording.recording import Recording

    if to not in FORMATS:
        raise UnknownName("format", to, FORMATS)
    first, last = parse_time("--start", start), parse_time("--end", end)
    path = output or file.with_suffix(f".{to}")
    if path.exists() and not force:
        raise RecordingError(f"{path} exists; choose another name with -o, or replace it with --force")
    if not path.parent.is_dir():
        raise RecordingError(f"cannot write {path}: there is no folder {path.parent}")
    names = None if fields is None else [name for name in (part.strip() for part in fields.split(",")) if name]
    recording = Recording(file)
    with make_progress(show=not json) as bar:
        task = bar.add_task("checking", total=1.0)
        chosen = Export.of(recording, to, names, first, last, lambda share: bar.update(task, completed=share))
    report_end(recording)
    with make_progress(show=not json) as bar:
        task = bar.add_task("writing", total=1.0)
        chosen.write(path, lambda share: bar.update(task, completed=share))
    ticks = len(chosen.ticks)
    if json:
        size = path.stat().st_size
        print_json({"file": str(path), "format": to, "ticks": ticks, "bytes": size, **list_missing(recording)})
    else:
        echo(f"{path}: {ticks} ticks")


def parse_time(option: str, text: str | None) -> float | None:
    """Parse a time with its unit [s]; a plain number is in seconds. InputError, naming `option`, for other text."""
    from haptorb.devices.quantity import si

    if text is None:
        return None
    try:
        return float(text)
    except ValueError:
        pass
    try:
        return si(text, "s", "a time")
    except ValueError as cause:
        raise InputError(f"{option} {cause}") from cause
