"""Recordings damaged at random: how many rows of undamaged chunks are read, and whether every loss is named.

    python tests/fuzz/damaged_recordings.py [--files 1000] [--commands 20] [--seed 1] [--folder DIR] [--json]

A recording of three seconds is written with each compression that MCAP has, and damaged: 1 to 20 bytes anywhere get
other values, and every fourth file is also cut at any place. Which chunks are undamaged is known from the makers'
`mcap` library, which lists their places in the file before the damage. Of every file, Python must read the rows of
these chunks, and no others; where rows are missing, it must name that. `haptorb info`, `export`, `view` and `replay`
must do so, too, on standard error and in their JSON: tried with the first `--commands` files with a loss. Ends with 1
unless 99 % of the rows of undamaged chunks are read, none is wrong, and every loss is named.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from haptorb import Recording, Servo
from haptorb.cli import main as run_command
from haptorb.errors import HaptorbError

_SECONDS = 3.0
_MOST = 20  #: damaged bytes of a file
_COMPRESSIONS = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}


def record(path: Path) -> Path:
    """A recording of a simulated device."""
    with Servo("omni", "dome", record=str(path), overwrite=True) as servo:
        servo.run(_SECONDS)
    return path


def make_recordings(first: Path, folder: Path) -> dict[str, Path]:
    """Compression → the recording `first`, written again by the makers' library with it."""
    return {name: first if name == "zstd" else compress(first, folder / f"{name}.mcap", kind)
            for name, kind in _COMPRESSIONS.items()}  # fmt: skip


def compress(source: Path, out: Path, kind: CompressionType) -> Path:
    """The recording with another compression, by the makers' library only."""
    with source.open("rb") as file, out.open("wb") as made:
        reader = make_reader(file)
        writer = Writer(made, chunk_size=32_000, compression=kind)
        writer.start(profile="ros2", library="another program")
        channels: dict[int, int] = {}
        for note in reader.iter_metadata():
            writer.add_metadata(note.name, note.metadata)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if channel.id not in channels:
                assert schema is not None
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, known)
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.finish()
    return out


def list_chunks(path: Path) -> list[tuple[int, int, int]]:
    """(first byte, end, messages) of each chunk in order, as the makers' library reads them."""
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        chunks = sorted(summary.chunk_indexes, key=lambda one: one.chunk_start_offset)
        counts = []
        for one in chunks:
            # Of each channel the index has 16 bytes for each message, after a head of 15 bytes.
            counts.append((one.message_index_length - 15 * len(one.message_index_offsets)) // 16)
    return [(one.chunk_start_offset, one.chunk_start_offset + one.chunk_length, count)
            for one, count in zip(chunks, counts, strict=True)]  # fmt: skip


def damage(data: bytes, draw: np.random.Generator, *, cut: bool) -> tuple[bytes, list[int]]:
    """`data` with 1 to 20 other bytes, perhaps cut; and the places of the damaged bytes."""
    size = int(draw.integers(len(data) // 10, len(data))) if cut else len(data)
    places = np.unique(draw.integers(0, size, int(draw.integers(1, _MOST + 1))))
    changed = np.frombuffer(data[:size], np.uint8).copy()
    changed[places] ^= draw.integers(1, 256, len(places), dtype=np.uint8)
    return changed.tobytes(), places.tolist()


def undamaged_rows(chunks: list[tuple[int, int, int]], places: list[int], size: int) -> np.ndarray:
    """Numbers of the rows whose chunks have no damaged byte and lie in the first `size` bytes."""
    whole, row = [], 0
    for first, end, count in chunks:
        if end <= size and not any(first <= at < end for at in places):
            whole.append(np.arange(row, row + count))
        row += count
    return np.concatenate(whole) if whole else np.empty(0, dtype=np.int64)


def try_reader(path: Path, rows: np.ndarray, expected: np.ndarray) -> dict[str, Any]:
    """What Python reads of the damaged file, compared with the `expected` of all `rows`."""
    found: dict[str, Any] = {"expected": len(expected), "read": 0, "wrong": 0, "lost": False, "named": True, "said": ""}
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        try:
            recording = Recording(path)
        except HaptorbError as cause:
            return {**found, "lost": True, "refused": str(cause)}
    ticks = recording["tick"][:]
    numbers = np.searchsorted(rows[:, recording._at["tick"].start], ticks)
    same = recording.rows.tobytes() == rows[np.minimum(numbers, len(rows) - 1)].tobytes()
    found["read"] = int(np.isin(expected, numbers).sum())
    found["wrong"] = 0 if same else len(ticks)
    found["lost"] = len(ticks) < len(rows)
    missing = sum(one.rows or 0 for one in recording.missing)
    counted = missing == len(rows) - len(ticks) or any(one.rows is None for one in recording.missing)
    named = recording.truncated or (bool(recording.damage) and len(seen) > 0)
    found["named"] = not found["lost"] or (named and counted and bool(recording.missing))
    return found


def run(*words: str) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command."""
    out, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        try:
            code = run_command(list(words))
        except SystemExit as end:
            code = int(end.code or 0)
    return code, out.getvalue(), error.getvalue()


def try_commands(path: Path) -> list[str]:
    """The commands that do not name the loss of `path` on standard error and in their JSON."""
    silent = []
    out, whole = path.with_suffix(".npz"), path.with_name("repaired.mcap")
    commands = {
        "info": ("info", str(path), "--json"),
        "export": ("export", str(path), "--to", "npz", "-o", str(out), "--force", "--json"),
        "replay": ("replay", str(path), "--world", "recorded", "--json"),
        "view": ("view", str(path), "--port", "0", "--duration", "0.2", "--json"),
        "info --repair": ("info", str(path), "--repair", str(whole), "--force", "--json"),
    }
    for name, words in commands.items():
        code, text, error = run(*words)
        if code == 2:
            continue  # refused, with a reason
        try:
            told = json.loads(text)
        except ValueError:
            told = {}
        told = told["recordings"][0] if "recordings" in told else told
        if not told.get("missing") or not ("missing" in error or "damaged" in error):
            silent.append(f"{name}: {error[:100]}{text[:100]}")
    if out.exists():
        with np.load(out, allow_pickle=False) as archive:
            about = json.loads(str(archive["about"]))["recording"]
        if not (about.get("damage") or about.get("truncated")):
            silent.append("exported metadata")
        with whole.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            count = sum(1 for _ in reader.iter_messages())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if count != len(Recording(path)) or Recording(whole).truncated:
                silent.append("the repaired file is not whole")
    return silent


def measure(first: Path, files: int, commands: int, seed: int, folder: Path) -> dict[str, Any]:
    """The whole experiment, with the recording `first`."""
    draw = np.random.default_rng(seed)
    made = make_recordings(first, folder)
    known = {name: (path.read_bytes(), list_chunks(path), Recording(path).rows) for name, path in made.items()}
    total: dict[str, Any] = {"files": files, "expected": 0, "read": 0, "wrong": 0, "losses": 0, "unnamed": 0,
                             "refused": [], "silent": [], "tried_with_commands": 0}  # fmt: skip
    path = folder / "damaged.mcap"
    for number in range(files):
        data, chunks, rows = known[list(known)[number % len(known)]]
        content, places = damage(data, draw, cut=number % 4 == 3)
        path.write_bytes(content)
        expected = undamaged_rows(chunks, places, len(content))
        one = try_reader(path, rows, expected)
        for key in ("expected", "read", "wrong"):
            total[key] += one[key]
        total["losses"] += one["lost"]
        if "refused" in one and one["expected"]:
            total["refused"].append(f"file {number}, {one['expected']} rows: {one['refused']}")
        if not one["named"]:
            total["unnamed"] += 1
            total["silent"].append(f"file {number}: Python")
        if one["lost"] and "refused" not in one and total["tried_with_commands"] < commands:
            total["tried_with_commands"] += 1
            total["silent"] += [f"file {number}: {text}" for text in try_commands(path)]
    total["share"] = total["read"] / max(total["expected"], 1)
    return total


def main() -> int:
    """Measure, and print for people or machines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--commands", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        found = measure(record(Path(folder, "first.mcap")), options.files, options.commands, options.seed, Path(folder))
    if options.json:
        print(json.dumps(found, indent=1))
    else:
        share = f"{100 * found['share']:.3f} % of {found['expected']} rows of undamaged chunks are read"
        print(f"{found['files']} damaged recordings: {share}, {found['wrong']} rows are wrong")
        print(f"{found['losses']} with a loss, {found['unnamed']} not named; refused whole: {len(found['refused'])}")
        print(f"{found['tried_with_commands']} tried with the commands")
        for text in (*found["refused"], *found["silent"]):
            print(text)
    return int(found["share"] < 0.99 or found["wrong"] > 0 or bool(found["silent"]))


if __name__ == "__main__":
    sys.exit(main())
