"""Terrain over the dome: forces are its slopes, for any source of heights."""

import numpy as np
import pytest
from PIL import Image

from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import InputError
from haptorb.worlds import Terrain

OMNI = load("omni")


def potential(terrain, p):
    """U = F₀ h (d_c/3)(d_c/d)³, with the height taken back from the radial force."""
    d = np.linalg.norm(p)
    radial = terrain.wrench(State.at(p))[:3] @ (p / d)
    return radial * d / 3


def test_force_is_the_slope_of_its_potential():
    terrain = Terrain().for_device(OMNI)
    rng = np.random.default_rng(2)
    for _ in range(100):
        p = rng.normal(size=3)
        p[2] = abs(p[2]) + 0.6
        p *= rng.uniform(0.051, 0.068) / np.linalg.norm(p)
        slope = [(potential(terrain, p + e) - potential(terrain, p - e)) / 2e-6 for e in 1e-6 * np.eye(3)]
        assert np.allclose(terrain.wrench(State.at(p))[:3], -np.array(slope), atol=2e-5)


def test_mountains_push_and_valleys_pull():
    mountain = Terrain.of(lambda tilt, azimuth: np.exp(-((tilt / 0.3) ** 2)))
    valley = Terrain.of(lambda tilt, azimuth: -np.exp(-((tilt / 0.3) ** 2)))
    top = State.at((0, 0, 0.05))
    assert mountain.wrench(top)[2] == pytest.approx(0.5)
    assert valley.wrench(top)[2] == pytest.approx(-0.5)
    beside = State.at((0.05 * np.sin(0.2), 0, 0.05 * np.cos(0.2)))
    assert mountain.wrench(beside)[:3] @ (np.cos(0.2), 0, -np.sin(0.2)) > 0  # downhill, away from the top
    assert valley.wrench(beside)[:3] @ (np.cos(0.2), 0, -np.sin(0.2)) < 0  # into the valley


def test_from_an_image(tmp_path):
    v, u = np.meshgrid(np.linspace(-1, 1, 64), np.linspace(-1, 1, 64), indexing="ij")
    picture = np.uint8(255 * np.exp(-((u - 0.3) ** 2 + (v + 0.2) ** 2) / 0.1))
    Image.fromarray(picture).save(tmp_path / "hill.png")
    terrain = Terrain.image(tmp_path / "hill.png")
    tilt = np.hypot(0.3, 0.2) * np.radians(60)
    azimuth = np.arctan2(0.2, 0.3)  # the image's top is +y
    s = 0.05 * np.sin(tilt)
    hill = State.at((s * np.cos(azimuth), s * np.sin(azimuth), 0.05 * np.cos(tilt)))
    assert terrain.wrench(hill)[:3] @ hill.axis == pytest.approx(0.5, rel=0.03)
    Image.fromarray(np.uint16(picture) * 257).save(tmp_path / "deep.png")
    assert np.allclose(Terrain.image(tmp_path / "deep.png").heights, terrain.heights)


@pytest.mark.parametrize(
    ("heights", "told"),
    [
        (np.full((8, 8), np.nan), "NaN"),
        (np.zeros((8, 9)), "square"),
        (np.zeros((3, 3)), "at least 4"),
        (np.zeros(8), "square"),
        (np.full((8, 8), 3.0), "−1…1"),
    ],
)
def test_height_maps_that_cannot_be(heights, told):
    with pytest.raises(InputError, match=told):
        Terrain(heights=heights)


def test_images_that_cannot_be(tmp_path):
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match="cannot be read"):
        Terrain.image(tmp_path / "a.png")
    with pytest.raises(InputError, match="cannot be read"):
        Terrain.image(tmp_path / "nothing.png")
    Image.fromarray(np.zeros((10, 20), np.uint8)).save(tmp_path / "b.png")
    with pytest.raises(InputError, match="20 × 10"):
        Terrain.image(tmp_path / "b.png")


def test_holes_are_told_with_their_place():
    """NaN, infinities and masked cells are holes, and so are the transparent pixels of an image."""
    heights = np.zeros((8, 8))
    heights[2, 3] = np.nan
    with pytest.raises(InputError, match=r"1 holes .* \[2, 3\]"):
        Terrain(heights=heights)
    with pytest.raises(InputError, match=r"8 holes .* \[0, 0\]"):
        Terrain(heights=np.ma.masked_array(np.zeros((8, 8)), mask=np.eye(8)))
    with pytest.raises(InputError, match="64 holes"):
        Terrain(heights=[[None] * 8] * 8)
    with pytest.raises(InputError, match="numbers"):
        Terrain(heights=[["high"] * 8] * 8)


def test_transparent_pixels_are_holes(tmp_path):
    picture = Image.new("RGBA", (16, 16), (128, 128, 128, 255))
    picture.save(tmp_path / "whole.png")
    assert Terrain.image(tmp_path / "whole.png").heights.shape == (16, 16)
    picture.putpixel((3, 4), (128, 128, 128, 0))
    picture.save(tmp_path / "holes.png")
    with pytest.raises(InputError, match="transparent"):
        Terrain.image(tmp_path / "holes.png")
