"""Code named by a recording runs only if this account started exactly that code, from there, by name."""

from __future__ import annotations

import importlib.util
import json
import os
import py_compile
import stat
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from haptorb.devices.base import State
from haptorb.errors import InputError
from haptorb.worlds.user_world import WorldFile, list_path, load_noted_world, note_start, note_world

WORLD = """
import numpy as np
from dataclasses import dataclass
from haptorb.worlds import World
from started_helper import pull

@dataclass(frozen=True)
class Groove(World):
    def wrench(self, state):
        import started_late
        return np.array([started_late.SHARE * pull(state.p[0]), 0, 0, 0, 0, 0])
"""
HELPER = "def pull(x):\n    return 20 * x\n"
HARM = "open({!r}, 'w').close()\n"
HERE = State.at((0.05, 0.0, 0.0))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Of a world in three files; nothing that it imports stays in this process."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    place = tmp_path / "worlds"
    place.mkdir()
    (place / "groove.py").write_text(WORLD)
    (place / "started_helper.py").write_text(HELPER)
    (place / "started_late.py").write_text("SHARE = 2.0\n")
    yield place
    forget()


def forget() -> None:
    """As in another process."""
    for name in [one for one in sys.modules if one.startswith("started_")]:
        del sys.modules[name]
    importlib.invalidate_caches()


def start(folder: Path) -> str:
    """A person starts the world; the note of it in a recording."""
    world = WorldFile(folder / "groove.py", "Groove").load()
    world.wrench(HERE)
    note_start(world)
    forget()
    sys.path[:] = [one for one in sys.path if one != str(folder)]
    return note_world(world)


def plant_compiled(folder: Path, harm: str) -> None:
    """A compiled file that passes for the helper's, made for its size and time."""
    there = folder / "started_helper.py"
    facts = there.stat()
    source = folder / "harm.txt"
    source.write_text((harm + HELPER).ljust(facts.st_size))
    made = Path(importlib.util.cache_from_source(str(there)))
    made.parent.mkdir(exist_ok=True)
    py_compile.compile(str(source), str(made), dfile=str(there))
    content = bytearray(made.read_bytes())
    content[8:16] = int(facts.st_mtime).to_bytes(4, "little") + facts.st_size.to_bytes(4, "little")
    made.write_bytes(content)


def rename(folder: Path, harm: str) -> None:
    folder.rename(folder.with_name("elsewhere"))


PLANTED: dict[str, Callable[[Path, str], object]] = {
    "the file is another": lambda folder, harm: (folder / "groove.py").write_text(harm + WORLD),
    "a module is another": lambda folder, harm: (folder / "started_helper.py").write_text(harm + HELPER),
    "a late module is another": lambda folder, harm: (folder / "started_late.py").write_text(harm + "SHARE = 2.0\n"),
    "numpy is beside it": lambda folder, harm: (folder / "numpy.py").write_text(harm),
    "a package hides the module": lambda folder, harm: (
        (folder / "started_helper").mkdir(), (folder / "started_helper" / "__init__.py").write_text(harm + HELPER)
    ),
    "it lies elsewhere": rename,
}  # fmt: skip


def test_what_this_account_started_runs_again(folder: Path) -> None:
    noted = start(folder)
    assert stat.S_IMODE(list_path().stat().st_mode) == 0o600
    again = load_noted_world(noted)
    np.testing.assert_array_equal(again.wrench(HERE), [2.0, 0, 0, 0, 0, 0])
    assert "started_late" in sys.modules


def test_a_compiled_file_beside_it_is_not_looked_at(folder: Path, tmp_path: Path) -> None:
    noted = start(folder)
    plant_compiled(folder, HARM.format(str(tmp_path / "canary")))
    load_noted_world(noted).wrench(HERE)
    assert not (tmp_path / "canary").exists()


@pytest.mark.parametrize("name", [None, *PLANTED])
def test_other_code_does_not_run_whatever_the_recording_says(name: str | None, folder: Path, tmp_path: Path) -> None:
    """None: the account has started nothing; the recording has the file's digest and calls it loaded."""
    harm = HARM.format(str(tmp_path / "canary"))
    if name is None:
        (folder / "groove.py").write_text(harm + WORLD)
        world = WorldFile(folder / "groove.py", "Groove").load()
        (tmp_path / "canary").unlink()
        forget()
        noted = note_world(world)
    else:
        noted = start(folder)
        PLANTED[name](folder, harm)
        note = json.loads(noted)
        place = Path(note["code"]["file"])
        if not place.exists():
            note["code"]["file"] = str(place.parent.with_name("elsewhere") / place.name)
        from hashlib import sha256

        note["code"]["digest"] = sha256(Path(note["code"]["file"]).read_bytes()).hexdigest()
        noted = json.dumps(note)
    with pytest.raises(InputError, match="not executed"):
        load_noted_world(noted)
    assert not (tmp_path / "canary").exists()


@pytest.mark.parametrize("change", ["name", "mode", "owner"])
def test_a_list_that_others_may_write_or_another_name_is_not_believed(
    change: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noted = start(folder)
    if change == "name":
        noted = noted.replace('"Groove"', '"pull"')
    elif change == "mode":
        list_path().chmod(0o666)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: 12345)
    with pytest.raises(InputError, match="not executed"):
        load_noted_world(noted)


@pytest.mark.parametrize("dtype", ["O", "(3,)<f8", "V8", "<f16", ">f8", "f8,O", "M8[s]", "U1", "<c16"])
def test_an_array_of_another_type_is_refused(dtype: str) -> None:
    value = {"array": "AAAAAAAAAAA=", "dtype": dtype, "shape": [1]}
    made = {"kind": "haptorb.worlds.terrain:Terrain", "fields": {"height": value}}
    with pytest.raises(InputError, match="numeric"):
        load_noted_world(json.dumps({"made": made}))


@pytest.mark.parametrize("shape", [[10**12], [-(2**70)], [1, 10**18], ["a"], None, [[1]]])
def test_an_array_of_an_impossible_shape_is_refused(shape: object) -> None:
    value = {"array": "AAAAAAAAAAA=", "dtype": "<f8", "shape": shape}
    made = {"kind": "haptorb.worlds.terrain:Terrain", "fields": {"height": value}}
    with pytest.raises(InputError, match="cannot create"):
        load_noted_world(json.dumps({"made": made}))
