"""A scene's file: watched files, and the state that is kept when it is saved."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from haptorb.errors import InputError, UnknownName
from haptorb.worlds.scene import Scene, SceneFile, parse_scene_file
from haptorb.worlds.scene_physics import find_scene_file, load_engine

TEXT = """<mujoco><worldbody><include file="part.xml"/>
<body name="peg"><freejoint/><geom size="0.01" mass="0.1"/></body></worldbody></mujoco>"""
PART = "<mujocoinclude><geom name='{name}' size='0.02' pos='0 0 -1'/></mujocoinclude>"


@pytest.fixture
def file(tmp_path: Path) -> SceneFile:
    (tmp_path / "mine.xml").write_text(TEXT)
    (tmp_path / "part.xml").write_text(PART.format(name="stone"))
    return parse_scene_file("mine.xml", folder=tmp_path)


def test_the_file_and_what_it_includes_are_watched(file: SceneFile) -> None:
    before = file.stamp
    assert before is not None
    assert file.load().name == "scene-mine"
    (file.path.parent / "part.xml").write_text(PART.format(name="another"))
    assert file.stamp != before
    file.path.unlink()
    assert file.stamp is None


def test_single_quotes_nested_includes_meshes_and_missing_files_are_watched(tmp_path: Path) -> None:
    """As in a scene whose `outer.xml` includes `middle.xml` in single quotes, which includes `inner.xml`."""
    (tmp_path / "meshes").mkdir()
    texts = {
        "outer.xml": "<mujoco><compiler meshdir='meshes'/><include file='middle.xml'/></mujoco>",
        "middle.xml": "<mujocoinclude><include file = 'inner.xml'/></mujocoinclude>",
        "inner.xml": "<mujocoinclude><asset><mesh name='m' file='part.obj'/></asset><worldbody><body name='peg'>"
        "<freejoint/><geom type='mesh' mesh='m' mass='0.1'/></body></worldbody></mujocoinclude>",
        "meshes/part.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    watched = parse_scene_file("outer.xml", folder=tmp_path)
    assert watched.load().name == "scene-outer"
    for name, text in texts.items():
        before = watched.stamp
        assert watched.stamp == before
        (tmp_path / name).write_text(text + "\n")
        assert watched.stamp != before, name
    before = watched.stamp
    (tmp_path / "meshes" / "part.obj").unlink()
    missing = watched.stamp
    assert missing != before
    (tmp_path / "meshes" / "part.obj").write_text(texts["meshes/part.obj"])
    assert watched.stamp != missing


def test_a_scene_may_be_longer_than_a_toml_file(tmp_path: Path) -> None:
    (tmp_path / "part.xml").write_text(PART.format(name="stone"))
    (tmp_path / "long.xml").write_text(TEXT.replace("<mujoco>", f"<mujoco><!-- {'x' * 400_000} -->"))
    assert parse_scene_file("long.xml", folder=tmp_path).load().name == "scene-long"


def test_values_are_those_of_the_command_line(file: SceneFile) -> None:
    assert SceneFile(file.path, "peg", {"stiffness": 120.0}).load().stiffness == 120.0
    with pytest.raises(InputError, match="stiffness"):
        SceneFile(file.path, "peg", {"stiffness": -1.0}).load()


def test_shipped_names_are_files_and_others_are_told() -> None:
    assert find_scene_file("outlet").is_file()
    with pytest.raises(UnknownName, match="boxes"):
        parse_scene_file("boxs")


def test_without_mujoco_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    load_engine.cache_clear()
    try:
        with pytest.raises(InputError, match=r"pip install 'haptorb\[scenes\]'") as told:
            Scene("peg")
    finally:
        load_engine.cache_clear()
    assert "\n" not in str(told.value)


def test_meshes_beside_the_scene_need_leave(tmp_path: Path) -> None:
    for name in ("scenes", "meshes"):
        (tmp_path / name).mkdir()
    (tmp_path / "meshes" / "part.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    path = tmp_path / "scenes" / "mine.xml"
    path.write_text(
        "<mujoco><compiler meshdir='../meshes'/><asset><mesh name='m' file='part.obj'/></asset><worldbody>"
        "<body name='peg'><freejoint/><geom type='mesh' mesh='m' mass='0.1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(InputError, match="--assets"):
        parse_scene_file(str(path)).load()
    allowed = parse_scene_file(str(path), assets=tmp_path)
    assert allowed.load().name == "scene-mine"
    before = allowed.stamp
    (tmp_path / "meshes" / "part.obj").write_text((tmp_path / "meshes" / "part.obj").read_text() + "\n")
    assert allowed.stamp != before
    path.write_text(path.read_text().replace("../meshes", "../../.."))
    with pytest.raises(InputError, match="lies outside"):
        parse_scene_file(str(path), assets=tmp_path).load()
    with pytest.raises(InputError, match="above the scene"):
        parse_scene_file(str(path), assets=tmp_path / "meshes")
