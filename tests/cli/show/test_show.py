"""`haptorb show`: positions and sizes of the drawing are those of the device file; mistakes are one line."""

from __future__ import annotations

import json
from importlib.resources import files

import numpy as np
import pytest

import haptorb
from haptorb.devices.loader import parse
from haptorb.errors import InputError
from oracles.command import run_command

OMNI = (files("haptorb.devices") / "catalogue" / "omni.toml").read_text(encoding="utf-8")
SIGNS = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}


def outlines(figure, name):
    """Vertices [mm] of the section's bodies of that name."""
    patches = [patch for patch in figure.axes[0].patches if patch.get_gid() == name]
    return np.concatenate([patch.get_path().vertices for patch in patches])


@pytest.mark.parametrize("suffix", sorted(SIGNS))
def test_it_writes_the_format_of_the_name(capsys, tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    view = "both" if suffix == ".png" else "section"
    code, out, _ = run_command(capsys, "show", "omni", "--view", view, "--output", str(path))
    assert code == 0
    assert str(path) in out
    assert path.read_bytes().startswith(SIGNS[suffix])


def test_without_a_name_the_file_is_called_after_the_device(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_command(capsys, "show", "omni", "--view", "section")[0] == 0
    assert [path.name for path in tmp_path.iterdir()] == ["omni.drawing.png"]


def test_coil_z_is_drawn_at_its_radii_in_millimetres():
    corners = outlines(haptorb.load("omni").draw("section"), "z")
    across = np.abs(corners[:, 0])
    assert across.max() == pytest.approx(27.25, abs=0.15)  # its moment leans by half a degree
    assert across.min() == pytest.approx(24.17, abs=0.15)
    assert np.abs(corners[:, 1]).max() == pytest.approx(8.15, abs=0.3)


def test_a_larger_coil_is_drawn_larger():
    device = parse(OMNI.replace("[18.0, 22.55, 27.25]", "[18.0, 22.55, 27.3]"), "mine.toml")
    assert np.abs(outlines(device.draw("section"), "z")[:, 0]).max() == pytest.approx(27.3, abs=0.15)


def test_coils_of_the_motor_are_cut_where_the_plane_is():
    pmsm = haptorb.load("pmsm")
    assert outlines(pmsm.draw("section"), "EM17")[:, 0].max() == pytest.approx(56.8 + 3.81, abs=1e-6)
    turned = pmsm.draw("section", azimuth=22.5)
    assert outlines(turned, "EM1")[:, 1].min() < -30
    assert not [patch for patch in turned.axes[0].patches if patch.get_gid() == "EM17"]


def test_what_the_file_does_not_state_is_said():
    before, after = OMNI.split("[windings]")
    known = 'inductance = ["0.4 mH", "0.4 mH", "0.4 mH"]\ncurrent_limit ='
    after = after[after.index("[dome]") :].replace("current_limit =", known)
    figure = parse(before + after, "bare.toml").draw("section")
    texts = " ".join(text.get_text() for text in [*figure.texts, *figure.legends[0].get_texts()])
    assert "not to scale: the windings' radii and lengths" in texts
    assert "coil (winding), not to scale" in texts


def test_numbers_have_units_in_their_keys(capsys):
    code, out, _ = run_command(capsys, "show", "pmsm", "--json")
    assert code == 0
    told = json.loads(out)
    place = next(part for part in told["parts"] if part["name"] == "EM17")["position_m"]
    assert place == pytest.approx([0.0568, 0, 0], abs=1e-9)
    assert told["workspace"]["half_angle_deg"] == pytest.approx(22.5)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["omi"], "did you mean 'omni'"),
        (["omni", "--output", "a.jpg"], "--output must be a .png, .svg or .pdf file; got 'a.jpg'"),
        (["omni", "--output", "/no/such/folder/a.png"], "--output: the folder '/no/such/folder' does not exist"),
        (["omni", "--output", "/proc/a.png"], "--output: cannot write '/proc/a.png'"),
        (["omni", "--view", "side"], "view of a drawing 'side'"),
        (["omni", "--azimuth", "nan"], "finite angle"),
        (["pmsm-printed"], "EM1 and EM17"),
    ],
)
def test_a_mistake_is_one_message_and_no_file(capsys, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    code, out, err = run_command(capsys, "show", *words)
    assert code == 2
    assert said in err
    assert not out
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["planar", "arm", "arm-touch"])
def test_an_edge_of_the_workspace_and_a_tool_are_drawn_to_scale(name):
    device = haptorb.load(name)
    figure = device.draw("section")
    axes = figure.axes[0]
    drawn = np.concatenate([line.get_xydata() for line in axes.lines if len(line.get_xydata())])
    known = [1e3 * edge.points[:, [0, 2]] for edge in device.geometry().edges]
    assert len(known) == (0 if name == "planar" else 6)
    for points in known:
        assert all(np.abs(drawn - point).max(axis=1).min() < 1e-9 for point in points)


def test_a_kind_without_geometry_says_so(monkeypatch):
    omni = haptorb.load("omni")
    monkeypatch.setattr(type(omni), "geometry", lambda self: None)
    with pytest.raises(InputError, match="haptorb show"):
        omni.draw()
