"""Malicious recordings: `replay`, `view`, `info` and `export` run none of their code, and end."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from haptorb import Recording
from haptorb.arrays import Array
from haptorb.cli import main
from haptorb.recording.mcap import Recorder
from oracles.recorded_chain import record_chain

Notes = list[tuple[str, dict[str, str]]]
HARM = """
open({canary!r}, "w").close()
import numpy as np
def groove(state):
    return np.zeros(6)
"""


def run(words: list[str], output: Path) -> int:
    """The exit code of the command in a process of its own; negative: a signal ended it, 70: an exception."""
    child = os.fork()
    if not child:
        code = 70
        with suppress(BaseException), output.open("w") as there:
            sys.stdout = sys.stderr = there
            signal.alarm(60)  # of a command that does not end
            try:
                code = main(words)
            except SystemExit as end:
                code = int(end.code or 0)
            except BaseException:
                traceback.print_exc()
        os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def rewrite(whole: Recording, path: Path, change: Callable[[Notes, Array], object]) -> None:
    """The recording once more, with notes and rows as `change` leaves them."""
    skipped = ("haptorb/layout", "haptorb/clock")
    notes: Notes = [(name, dict(values)) for name, values in whole.notes if name not in skipped]
    rows = whole.rows.copy()
    change(notes, rows)
    with path.open("wb") as file:
        recorder = Recorder(file, whole.layout, 1000.0, 0)
        for name, values in notes:
            recorder.add_metadata(name.removeprefix("haptorb/"), values)
        recorder.append(rows)
        recorder.finish()


def set_note(notes: Notes, name: str, **values: str) -> None:
    """In all notes of that name."""
    for one, held in notes:
        if one == f"haptorb/{name}":
            held.update(values)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Ticks of the simulated Omni in its dome."""
    return record_chain(tmp_path_factory.mktemp("foreign") / "run.mcap", ticks=60)


def check_commands(path: Path, canary: Path) -> str:
    """What the commands say of the recording; none of them crashes, raises, or runs the canary's code."""
    said = []
    for words in (
        ["replay", str(path)],
        ["view", str(path), "--port", "0", "--duration", "0.01", "--json"],
        ["info", str(path)],
        ["export", str(path), "--to", "npz", "--output", str(path.with_suffix(".npz"))],
    ):
        output = path.with_suffix(".txt")
        code = run(words, output)
        text = output.read_text()
        assert code in (0, 1, 2), (words, code, text[-2000:])
        assert "Traceback" not in text, (words, text[-2000:])
        assert not canary.exists(), words
        said.append(text)
    return "\n".join(said)


@pytest.mark.parametrize("kind", ["code", "made", "scene", "pipe", "package"])
def test_a_world_that_a_recording_names_runs_nothing(
    kind: str, whole: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    canary, file = tmp_path / "canary", tmp_path / "groove.py"
    file.write_text(HARM.format(canary=str(canary)))
    os.mkfifo(tmp_path / "pipe")
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    code = {"file": str(file), "name": "groove", "digest": digest, "loaded": "yes", "made": ""}
    own = "haptorb.worlds.user_world:WorldFile"
    notes = {
        "code": {"code": code},
        "made": {"made": {"kind": own, "fields": {"path": str(file)}}},
        "scene": {"made": {"kind": "haptorb.worlds.scene:Scene",
                           "fields": {"model": {"scene": str(file), "digest": digest}}}},
        "pipe": {"code": {**code, "file": str(tmp_path / "pipe")}},
        "package": {"made": {"kind": "haptorb.worlds.user_world:FunctionWorld",
                             "fields": {"function": "os.system"}}},
    }  # fmt: skip

    def change(notes_there: Notes, rows: Array) -> None:
        description = json.dumps({"name": "groove", "values": {}})
        set_note(notes_there, "run", first_world=description, worlds=json.dumps({"groove": json.dumps(notes[kind])}))
        set_note(notes_there, "world", world=description)

    rewrite(whole, tmp_path / "harm.mcap", change)
    said = check_commands(tmp_path / "harm.mcap", canary)
    assert "recorded wrench" in said.replace("\n", " ")


@pytest.mark.parametrize(
    ("name", "number"),
    [("", np.nan), ("", np.inf), ("", 1e19), ("", -3.7), ("commands", np.nan), ("commands", 0.5), ("world", 1e19),
     ("tick", np.inf)],
)  # fmt: skip
def test_rows_that_no_loop_has_written_crash_nothing(
    name: str, number: float, whole: Recording, tmp_path: Path
) -> None:
    """The field is that number for some ticks; "": all fields that may be."""
    refused, layout = ("commands", "world", "wall"), whole.layout
    names = [name] if name else [one.name for one in layout.fields if one.width and one.name not in refused]

    def change(notes: Notes, rows: Array) -> None:
        for row, one in enumerate(names):
            rows[row : row + 3, layout[one]] = number

    rewrite(whole, tmp_path / "harm.mcap", change)
    said = check_commands(tmp_path / "harm.mcap", tmp_path / "canary")
    assert ("cannot be replayed" in said) == (name in refused)
