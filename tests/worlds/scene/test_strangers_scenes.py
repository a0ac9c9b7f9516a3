"""Foreign scenes: bounded files and resources, and an isolated compiler."""

from __future__ import annotations

import os
import resource
import struct
from pathlib import Path

import pytest

from fuzz.reading_scenes import READING, make_reading_scene, write_outside
from haptorb import limited_process
from haptorb.errors import InputError
from haptorb.limited_process import ProcessFailure, run_limited
from haptorb.worlds import scene_check, scene_compiler, scene_physics
from haptorb.worlds.scene_check import check_scene_file
from haptorb.worlds.scene_compiler import compile_scene
from haptorb.worlds.scene_physics import SHIPPED, find_scene_file, load_engine, make_scene_model

BODY = "<body name='peg'><freejoint/><geom size='1'/></body>"


def scene(folder: Path, world: str = BODY, more: str = "", name: str = "it.xml") -> Path:
    path = folder / name
    path.write_text(f"<mujoco>{more}<worldbody>{world}</worldbody></mujoco>")
    return path


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as told:
        make_scene_model(path)
    assert len(str(told.value).splitlines()) == 1
    return str(told.value)


@pytest.mark.parametrize(
    "world",
    [f"<replicate count='10000000'>{BODY}</replicate>",
     "<replicate count='1e9'>" * 3 + BODY + "</replicate>" * 3,
     "<replicate count='100'>" * 3 + BODY + "</replicate>" * 3,
     "<replicate count='inf'><geom size='1'/></replicate>",
     "<body>" * 95 + "</body>" * 95,
     "<composite type='grid' count='3000 3000 1' offset='0 0 1'><geom size='.1'/></composite>",
     "<flexcomp name='f' count='500 500 500' type='grid'/>"],
)  # fmt: skip
def test_a_scene_asks_for_no_more_than_there_can_be(tmp_path: Path, world: str) -> None:
    assert "elements" in refusal(scene(tmp_path, world))


@pytest.mark.parametrize(
    "more",
    ["<asset><texture name='t' type='2d' builtin='flat' width='100000' height='100000'/></asset>",
     "<asset><hfield name='h' nrow='100000' ncol='100000' size='1 1 1 1'/></asset>",
     "<!DOCTYPE a [<!ENTITY b 'c'>]>"],
)  # fmt: skip
def test_a_scene_computes_no_large_picture(tmp_path: Path, more: str) -> None:
    assert "make it smaller" in refusal(scene(tmp_path, more=more)) or "document type" in refusal(tmp_path / "it.xml")


@pytest.mark.parametrize(
    "named",
    ["<asset><mesh name='m' file='NAME'/></asset>", "<asset><hfield name='m' file='NAME' size='1 1 1 1'/></asset>",
     "<asset><texture name='m' type='2d' file='NAME'/></asset>", "<asset><skin name='m' file='NAME'/></asset>",
     "<include file='NAME'/>", "<asset><model name='m' file='NAME'/></asset>",
     "<asset><texture name='m' type='cube' fileup='NAME'/></asset>"],
)  # fmt: skip
def test_what_a_scene_names_is_a_file_of_its_folder(tmp_path: Path, named: str) -> None:
    outside, folder = tmp_path / "canary.xml", tmp_path / "scene"
    folder.mkdir()
    outside.write_text("<mujoco/>")
    os.mkfifo(folder / "pipe.xml")
    (folder / "link.xml").symlink_to(outside)
    (folder / "zero.xml").symlink_to("/dev/zero")
    for name in ("../canary.xml", str(outside), "link.xml", "zero.xml", "/dev/zero", "a/../../canary.xml"):
        assert "lies outside" in refusal(scene(folder, more=named.replace("NAME", name))), name
    assert "not a regular file" in refusal(scene(folder, more=named.replace("NAME", "pipe.xml")))


@pytest.mark.parametrize("key", ["meshdir", "texturedir", "assetdir"])
def test_a_scene_looks_in_no_other_folder(tmp_path: Path, key: str) -> None:
    (tmp_path / "scene").mkdir()
    assert "lies outside" in refusal(scene(tmp_path / "scene", more=f"<compiler {key}='..'/>"))


@pytest.fixture
def ground(tmp_path: Path) -> tuple[Path, Path]:
    """Folder of scenes, and one outside with files that MuJoCo can load."""
    folder, outside = tmp_path / "scene", tmp_path / "outside"
    folder.mkdir()
    write_outside(outside)
    return folder, outside


@pytest.mark.parametrize("form", READING)
def test_no_form_of_a_name_reads_outside(form: str, ground: tuple[Path, Path]) -> None:
    """The files outside are valid: a scene that reads one is compiled."""
    path = make_reading_scene(form, *ground)
    with pytest.raises(InputError, match=r"file of a scene|dir of a scene|is not XML"):
        check_scene_file(path)


@pytest.mark.parametrize("form", READING)
def test_the_compiler_opens_nothing_even_if_the_check_missed_it(form: str, ground: tuple[Path, Path]) -> None:
    folder, outside = ground
    path = make_reading_scene(form, folder, outside)
    inside = {str(file): file.read_bytes() for file in (path, *folder.iterdir()) if file.is_file()}
    with pytest.raises(ProcessFailure, match=r"^(?!.*longer)"):
        compile_scene(load_engine(), path, inside)


def test_a_file_that_changes_after_the_check_is_not_read(
    ground: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, outside = ground
    field = folder / "h.bin"
    field.write_bytes(struct.pack("<2i4f", 2, 2, 0.0, 1.0, 1.0, 1.0))
    path = scene(folder, more="<asset><hfield name='h' size='1 1 1 1' file='h.bin'/></asset>")

    def compile_later(engine: object, path: Path, files: dict[str, bytes]) -> object:
        field.unlink()
        field.symlink_to(outside / "h.bin")
        path.write_text("<mujoco/>")
        return compile_scene(engine, path, files)

    monkeypatch.setattr(scene_physics, "compile_scene", compile_later)
    assert list(make_scene_model(path).model.hfield_data) == [0.0, 1.0, 1.0, 1.0]


def test_an_archive_is_refused_by_its_content(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_bytes(b"PK\x03\x04")
    assert "unpack it" in refusal(scene(tmp_path, more="<asset><mesh name='m' file='m.obj'/></asset>"))


def test_names_at_too_many_places_are_not_looked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = "".join(f"<texture name='t{n}' file='{n}.png'/>" for n in range(20))
    monkeypatch.setattr(scene_check, "_NAMES", 50)
    folders = "<compiler meshdir='a' texturedir='b'/>"
    assert "fewer names" in refusal(scene(tmp_path, more=f"{folders}<asset>{names}</asset>"))


def test_a_missing_file_is_not_replaced_by_one_of_the_same_name(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    mesh = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "other" / "m.obj").write_text(mesh)
    meshes = "<mesh name='a' file='other/m.obj'/><mesh name='b' file='lost/M.obj'/>"
    assert "'lost/M.obj': does not exist" in refusal(scene(tmp_path, more=f"<asset>{meshes}</asset>"))


#: files of the folder, as far as they differ from `meshes/a.obj`, and text before the world
_LAYOUTS: dict[str, tuple[str, ...]] = {
    "folder with a slash": ("<compiler meshdir='./meshes/'/><asset><mesh name='m' file='a.obj'/></asset>",),
    "way back": ("<asset><mesh name='m' file='gone/../meshes//a.obj'/></asset>",),
    "folders ignored": ("<compiler meshdir='meshes' strippath='true'/><asset><mesh name='m' file='x/a.obj'/></asset>",),
    "included": (
        "<compiler assetdir='meshes'/><include file='sub/part.xml'/>",
        "<mujoco><asset><mesh name='m' file='a.obj'/></asset></mujoco>",
    ),
    "attached": (
        "<asset><mesh name='m' file='linked/a.obj'/><model name='s' file='sub/part.xml'/></asset>",
        "<mujoco><compiler meshdir='own'/><asset><mesh name='n' file='b.obj'/></asset><worldbody>"
        "<body name='b'><geom type='mesh' mesh='n'/></body></worldbody></mujoco>",
    ),
}


@pytest.mark.parametrize("layout", _LAYOUTS)
def test_files_in_folders_are_found_as_by_mujoco_itself(tmp_path: Path, layout: str) -> None:
    import mujoco

    more, *parts = _LAYOUTS[layout]
    for name in ("sub", "meshes"):
        (tmp_path / name).mkdir()
    (tmp_path / "linked").symlink_to("meshes")
    mesh = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "meshes" / "a.obj").write_text(mesh)
    (tmp_path / "sub" / "own").mkdir()
    (tmp_path / "sub" / "own" / "b.obj").write_text(mesh)
    for part in parts:
        (tmp_path / "sub" / "part.xml").write_text(part)
    attached = "<frame><attach model='s' body='b' prefix='p'/></frame>" if layout == "attached" else ""
    path = scene(tmp_path, BODY.replace("size='1'", "type='mesh' mesh='m'") + attached, more)
    apart, here = make_scene_model(path).model, mujoco.MjModel.from_xml_path(str(path))
    assert apart.nmesh == here.nmesh > 0
    assert bytes(apart.mesh_vert) == bytes(here.mesh_vert)


def test_files_that_include_each_other_are_counted_once(tmp_path: Path) -> None:
    scene(tmp_path, "<include file='b.xml'/>", name="a.xml")
    (tmp_path / "b.xml").write_text("<mujocoinclude><include file='b.xml'/></mujocoinclude>")
    assert "includes itself" in refusal(tmp_path / "a.xml")
    for n in range(12):  # 2^12 of the last one
        inner = f"<include file='n{n + 1}.xml'/>" * 2 if n < 11 else "<geom size='1'/>" * 100
        (tmp_path / f"n{n}.xml").write_text(f"<mujocoinclude>{inner}</mujocoinclude>")
    told = refusal(scene(tmp_path, "<include file='n0.xml'/>"))
    assert "elements" in told or "nested too deep" in told


def test_a_compiler_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    """By the processor's time, here 1 s, long before the limit by the clock."""
    program = tmp_path / "busy.py"
    program.write_text(
        f"import runpy\nrunpy.run_path({limited_process.__file__!r})['set_limits'](1, 1 << 30, 0)\nwhile True: pass\n"
    )
    with pytest.raises(ProcessFailure, match="of the processor"):
        run_limited(program, [], tmp_path, 15, 1 << 30)


def test_a_compiler_that_crashes_is_a_message(tmp_path: Path) -> None:
    program = tmp_path / "crash.py"
    program.write_text("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n")
    with pytest.raises(ProcessFailure, match="signal 11"):
        run_limited(program, [], tmp_path, 1, 1 << 30)


def test_a_compiler_that_takes_too_much_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points = "".join(f"v {n % 97} {n % 89} {n % 83}\n" for n in range(60_000))
    faces = "".join(f"f {n + 1} {n + 2} {n + 3}\n" for n in range(59_000))
    (tmp_path / "m.obj").write_text(points + faces)
    mesh = scene(
        tmp_path, BODY.replace("size='1'", "type='mesh' mesh='m'"), "<asset><mesh name='m' file='m.obj'/></asset>"
    )
    monkeypatch.setattr(scene_compiler, "_MEMORY", 64 * 1024 * 1024)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert "64 MiB of memory" in refusal(mesh)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 64 * 1024


def test_a_scene_compiled_apart_is_the_same(tmp_path: Path) -> None:
    import mujoco

    for name in SHIPPED:
        copy = tmp_path / f"{name}.xml"
        copy.write_bytes(find_scene_file(name).read_bytes())
        apart, here = make_scene_model(copy).model, mujoco.MjModel.from_xml_path(str(copy))
        for part in ("body_mass", "geom_size", "qpos0", "names", "dof_damping", "geom_solref"):
            assert bytes(getattr(apart, part)) == bytes(getattr(here, part)), part
