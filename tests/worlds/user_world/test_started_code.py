"""Code named by a recording runs only if this account started exactly that code, from there, by name."""

from __future__ import annotations

import importlib.util
import json
import os
import py_compile
import shutil
import stat
import sys
import time
import tracemalloc
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from haptorb.devices.base import State
from haptorb.errors import InputError
from haptorb.own_code import find_imports
from haptorb.runtime.servo import Servo
from haptorb.worlds import CATALOGUE, Fluid, PathGuidance, Remote, Scene, Sum
from haptorb.worlds.scene_physics import find_scene_file
from haptorb.worlds.user_world import WorldFile, list_path, load_noted_world, note_scenes, note_start, note_world

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
#: between two parts of a name, where Python reads on
GAPS = ("\\\n  ", "\\\r\n", "\\\r", "\f", "\f\t\\\r\n ")


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


class Opened:
    """Names of the files that this process opens or looks at, while it is told to listen."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.listens = False
        sys.addaudithook(self._note)  # cannot be removed

    def _note(self, event: str, arguments: tuple[object, ...]) -> None:
        if self.listens and event == "open" and isinstance(arguments[0], str):
            self.names.append(arguments[0])


OPENED = Opened()


@pytest.fixture
def opened() -> Iterator[list[str]]:
    """Names of the files that are opened in the test."""
    OPENED.names.clear()
    OPENED.listens = True
    yield OPENED.names
    OPENED.listens = False


def test_a_file_from_which_this_account_started_nothing_is_not_opened(folder: Path, opened: list[str]) -> None:
    start(folder)
    other = folder.with_name("other")
    other.mkdir()
    for name in ("groove.py", "scene.xml"):
        (other / name).write_text(WORLD)
    opened.clear()
    code = {"file": str(other / "groove.py"), "name": "Groove", "digest": "0" * 64, "loaded": "yes", "made": ""}
    scenes = [{"scene": str(other / "scene.xml"), "digest": "0" * 64}, str(other / "scene.xml")]
    made = [{"kind": "haptorb.worlds.scene:Scene", "fields": {"source": scene}} for scene in scenes]
    for note in ({"code": code}, *({"made": one} for one in made)):
        with pytest.raises(InputError):
            load_noted_world(json.dumps(note))
    assert list_path().name in {Path(name).name for name in opened}
    assert [name for name in opened if str(other) in name] == []


def test_modules_beside_a_world_have_an_end(folder: Path) -> None:
    noted = start(folder)
    with (folder / "started_helper.py").open("r+b") as file:
        file.truncate(1 << 28)
    tracemalloc.start()
    with pytest.raises(InputError, match="longer than"):
        load_noted_world(noted)
    assert tracemalloc.get_traced_memory()[1] < 50 << 20
    tracemalloc.stop()


def test_all_modules_beside_a_world_have_an_end_together(folder: Path) -> None:
    for name in ("started_helper", "started_late"):
        (folder / f"{name}.py").write_text("#" * 2_200_000)
    with pytest.raises(InputError, match="more than 4 MiB of modules"):
        find_imports(folder / "groove.py", WORLD)


@pytest.mark.parametrize(
    ("first", "encoding"),
    [
        ("", "utf-8-sig"),
        ("# coding: latin-1\nANGLE = '\xe4'\n", "latin-1"),
        ("# coding: none\n", "utf-8"),
        ("", "utf-8"),
    ],
)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_imports_of_an_import_are_found_as_python_reads_it(first: str, encoding: str, end: str, folder: Path) -> None:
    text = f"{first}import \\\n\fstarted_late\n".replace("\n", end)
    (folder / "started_helper.py").write_bytes(text.encode(encoding))
    found = find_imports(folder / "groove.py", "import started_helper")
    assert set(found) == {folder / "started_helper.py", folder / "started_late.py"}


@pytest.mark.parametrize(
    "source",
    ["import " + ".".join("a" * 50_000), "import " + ".".join("℘" * 20_000), "import " + ".".join(["e\u0301"] * 20_000),
     *("import a" + f".{gap}a" * 50_000 for gap in GAPS),
     f"import {'a' * 300}", f"from {'x' * 300} import y", "x = " + "(" * 5000,
     "import started_helper\n" + "-" * 100_000 + "1"],
    ids=["many parts", "many letters", "many accents", *(f"gap {number + 1}" for number in range(len(GAPS))),
         "long name", "long package",
         "brackets", "minus signs"],
)  # fmt: skip
def test_the_search_for_imports_ends_for_any_source(source: str, folder: Path) -> None:
    start = time.process_time()
    with suppress(InputError):
        assert set(find_imports(folder / "groove.py", source)) <= {folder / "started_helper.py"}
    assert time.process_time() - start < 1.0


def test_a_module_in_another_encoding_has_the_text_that_python_reads(folder: Path) -> None:
    helper, texts = folder / "started_helper.py", set()
    for sign in (b"\xa3", b"\xab"):  # a comment and a sum, both no UTF-8
        helper.write_bytes(b"# coding: mac_arabic\nx = 1 " + sign + b" 2\n")
        texts.add(find_imports(folder / "groove.py", "import started_helper")[helper])
    assert len(texts) == 2


@pytest.mark.parametrize("encoding", ["punycode", "idna", "raw_unicode_escape", "utf-7", "rot13", "hex"])
def test_the_encoding_of_a_module_takes_no_time_and_ends_nothing(encoding: str, folder: Path) -> None:
    helper = folder / "started_helper.py"
    helper.write_bytes(f"# coding: {encoding}\n# \\ud800 {'a-b9' * 100_000}\n".encode())
    start = time.process_time()
    find_imports(folder / "groove.py", "import started_helper")[helper].encode()
    assert time.process_time() - start < 1.0


def test_more_modules_than_any_world_has_are_refused(folder: Path) -> None:
    for number in range(501):
        (folder / f"started_{number}.py").touch()
    with pytest.raises(InputError, match="more than 500 modules"):
        find_imports(folder / "groove.py", "\n".join(f"import started_{number}" for number in range(501)))


def test_a_scene_that_this_account_started_is_read_again_while_it_is_the_same(folder: Path) -> None:
    path = folder / "scene.xml"
    shutil.copy(find_scene_file("peg"), path)
    scene = Scene(path)
    noted = note_world(scene)
    with pytest.raises(InputError, match="not on this account's list"):
        load_noted_world(noted)
    note_start(scene)
    again = load_noted_world(noted)
    assert isinstance(again, Scene)
    assert again.model.file == path
    text = path.read_text()
    path.write_text(text.replace("<mujoco", "<!-- -->\n<mujoco", 1))
    changed = note_world(Scene(path))
    for one in (noted, changed):
        with pytest.raises(InputError, match="has changed"):
            load_noted_world(one)


def test_a_scene_in_a_sum_and_one_that_a_program_renders_are_read_again(folder: Path) -> None:
    path = folder / "scene.xml"
    shutil.copy(find_scene_file("peg"), path)
    added = Scene(path) + Fluid()
    noted = note_world(added)
    with pytest.raises(InputError, match="haptorb run --scene FILE"):
        load_noted_world(noted)
    note_scenes(added)
    assert isinstance(load_noted_world(noted), type(added))


@pytest.mark.realtime
def test_a_program_that_records_a_scene_may_replay_it(folder: Path) -> None:
    path = folder / "scene.xml"
    shutil.copy(find_scene_file("peg"), path)
    scene = Scene(path)
    with Servo("omni", scene, record=folder / "run.mcap") as servo:
        servo.run(0.1)
    assert isinstance(load_noted_world(note_world(scene)), Scene)


def test_a_supplied_scene_is_on_no_list(folder: Path) -> None:
    assert load_noted_world(note_world(Scene("peg"))).name == "scene-peg"


def make_note(kind: str, /, **values: object) -> str:
    return json.dumps({"made": {"kind": f"haptorb.worlds.{kind}", "fields": values}})


def list_arrays(value: object) -> object:
    array = np.asarray(value)
    data = b64encode(array.tobytes()).decode()
    return {"array": data, "dtype": array.dtype.str, "shape": list(array.shape)}


def make_path_note(**others: object) -> str:
    places = np.column_stack([np.full(201, 0.05), 2e-4 * np.arange(201), np.zeros(201)])
    values = {"places": list_arrays(places), "tangents": list_arrays(np.tile([0.0, 1.0, 0.0], (201, 1))),
              "spacing": 2e-4, "closed": False, **others}  # fmt: skip
    return make_note("path_guidance:PathGuidance", path={"kind": "haptorb.worlds.path:GuidancePath", "fields": values})


def test_the_path_of_a_note_is_read() -> None:
    world = load_noted_world(make_path_note())
    assert isinstance(world, PathGuidance)
    assert world.curve.length == pytest.approx(0.04)


@pytest.mark.parametrize(
    ("name", "value"),
    [("spacing", 1e-12), ("spacing", 0.0), ("spacing", -2e-4), ("spacing", 1e300), ("spacing", 1e-3),
     ("spacing", "2e-4"), ("spacing", None), ("spacing", True), ("spacing", list_arrays([2e-4])), ("closed", True),
     ("closed", 1.0), ("closed", None), ("tangents", list_arrays([[0.0, 1.0, 0.0]])),
     ("tangents", list_arrays(np.zeros((201, 3)))),
     ("tangents", list_arrays(np.tile([0.0, 1.0, 0.0], (200, 1)))), ("tangents", list_arrays(np.zeros(603))),
     ("tangents", list_arrays(np.tile([0.0, 1.0], (201, 1)))), ("tangents", {"tuple": [1.0]}), ("tangents", 1.0),
     ("places", list_arrays([[0.0, 0.0, 0.05]])), ("places", list_arrays(np.full((201, 3), np.nan))),
     ("places", list_arrays(np.zeros((201, 3)))), ("places", list_arrays(np.zeros((0, 3)))),
     ("places", list_arrays(np.full((201, 3), 1e300))), ("places", "x")],
)  # fmt: skip
def test_a_path_that_compiled_code_could_not_follow_is_refused(name: str, value: object) -> None:
    with pytest.raises(InputError):
        load_noted_world(make_path_note(**{name: value}))


DOME = {"kind": "haptorb.worlds.dome:Dome", "fields": {}}


@pytest.mark.parametrize(
    "noted",
    [make_note("user_world:WorldFile", path="/etc/passwd"), make_note("scene:SceneFile", path="/etc/passwd"),
     make_note("scene_physics:SceneModel", title="x", file="/x", model=DOME),
     make_note("scene_check:_SceneCheck", folder="/"), make_note("base:Shape", name="x", kind="mesh", size=None),
     make_note("moving:Varying", at=DOME), make_note("user_world:FunctionWorld", function=DOME),
     make_note("path:GuidancePath"), make_note("dome:Dome", contact_distance="x" * 9),
     make_note("dome:Dome", contact_distance=[0.05]), make_note("dome:Dome", reach=float("nan")),
     make_note("dome:Dome", tool_moment=1e300), make_note("dome:Dome", reach=True),
     make_note("path_guidance:PathGuidance", device=DOME), make_note("path_guidance:PathGuidance", path=DOME),
     make_note("guidance:Guidance", path={"tuple": [{"tuple": [0.0, 0.0, 0.001 * n]} for n in range(20_000)]}),
     make_note("terrain:Terrain", heights=DOME), make_note("moving:Orbit", dome={"kind": "x", "fields": {}}),
     make_note("moving:Orbit", dome={"kind": "haptorb.worlds.basic:Wall", "fields": {}}),
     make_note("base:Sum", parts={"tuple": [1.0]}), make_note("base:Sum", parts=DOME),
     make_note("base:Sum", parts={"tuple": [DOME] * 300}), make_note("snap_fit:SnapFit", hooks=1.0),
     make_note("snap_fit:SnapFit", material="x" * 1000), make_note("snap_fit:SnapFit", beam={"tuple": []}),
     make_note("scene:Scene", source=DOME), make_note("scene:Scene", source="peg"),
     make_note("scene:Scene", source={"scene": 1, "digest": 2}), make_note("basic:Wall", stiffness="x" * 1_000_000)],
)  # fmt: skip
def test_a_note_makes_worlds_of_the_catalogue_with_values_of_their_kind_and_nothing_else(noted: str) -> None:
    with pytest.raises(InputError):
        load_noted_world(noted)


def test_every_world_of_the_catalogue_is_made_again_from_its_note() -> None:
    for kind in CATALOGUE.values():
        world = kind()
        assert type(load_noted_world(note_world(world))) is kind
        both = load_noted_world(note_world(world + Remote()))
        assert both.parts[0].name == world.name if isinstance(both, Sum) else isinstance(world, Remote)
