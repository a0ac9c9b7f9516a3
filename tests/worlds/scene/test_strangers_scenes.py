"""Foreign scenes: bounded files and resources, and an isolated compiler."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import pytest

from haptorb.errors import InputError
from haptorb.worlds import scene_compiler
from haptorb.worlds.scene_physics import SHIPPED, find_scene_file, make_scene_model

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


def test_files_that_include_each_other_are_counted_once(tmp_path: Path) -> None:
    scene(tmp_path, "<include file='b.xml'/>", name="a.xml")
    (tmp_path / "b.xml").write_text("<mujocoinclude><include file='b.xml'/></mujocoinclude>")
    assert "includes itself" in refusal(tmp_path / "a.xml")
    for n in range(12):  # 2^12 of the last one
        inner = f"<include file='n{n + 1}.xml'/>" * 2 if n < 11 else "<geom size='1'/>" * 100
        (tmp_path / f"n{n}.xml").write_text(f"<mujocoinclude>{inner}</mujocoinclude>")
    told = refusal(scene(tmp_path, "<include file='n0.xml'/>"))
    assert "elements" in told or "nested too deep" in told


def test_a_compiler_that_takes_too_long_or_too_much_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points = "".join(f"v {n % 97} {n % 89} {n % 83}\n" for n in range(60_000))
    faces = "".join(f"f {n + 1} {n + 2} {n + 3}\n" for n in range(59_000))
    (tmp_path / "m.obj").write_text(points + faces)
    mesh = scene(
        tmp_path, BODY.replace("size='1'", "type='mesh' mesh='m'"), "<asset><mesh name='m' file='m.obj'/></asset>"
    )
    monkeypatch.setattr(scene_compiler, "_MEMORY", 64 * 1024 * 1024)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refusal(mesh)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 64 * 1024


def test_a_scene_compiled_apart_is_the_same(tmp_path: Path) -> None:
    import mujoco

    for name in SHIPPED:
        copy = tmp_path / f"{name}.xml"
        copy.write_bytes(find_scene_file(name).read_bytes())
        apart, here = make_scene_model(copy).model, mujoco.MjModel.from_xml_path(str(copy))
        for part in ("body_mass", "geom_size", "qpos0", "names", "dof_damping", "geom_solref"):
            assert bytes(getattr(apart, part)) == bytes(getattr(here, part)), part
