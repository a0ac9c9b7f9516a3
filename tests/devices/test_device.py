"""Attributes of a device, a state and a wrench map, and modules loaded by reading a device file."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, replace
from xml.etree import ElementTree

import numpy as np
import pytest

import haptorb
from haptorb.devices.base import State
from haptorb.devices.loader import catalogue

PROGRAM = """
import sys, time
import haptorb
for name in sys.argv[1:]:
    try:
        haptorb.load(name)
    except haptorb.HaptorbError:  # variants that nobody can build
        haptorb.load(name, override=True)
heavy = [name for name in ("numba", "pint", "scipy", "matplotlib") if name in sys.modules]
print(time.process_time(), heavy)
"""


def read(*names: str) -> tuple[float, str]:
    """The processor's time [s] of a program that reads device files, and which heavy packages it loaded."""
    done = subprocess.run([sys.executable, "-c", PROGRAM, *names], capture_output=True, text=True, check=True)
    seconds, heavy = done.stdout.strip().split(maxsplit=1)
    return float(seconds), heavy


def test_devices_are_read_without_compiler_and_unit_library() -> None:
    assert read(*catalogue())[1] == "[]"


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.parametrize("name", catalogue())
def test_a_device_is_read_in_a_second(name: str) -> None:
    read(name)  # byte code is written
    assert min(read(name)[0] for _ in range(3)) <= 1.0


@pytest.mark.parametrize("name", catalogue())
def test_a_device_shows_its_figures_with_units(name: str) -> None:
    device = haptorb.load(name, override=True)
    told = repr(device)
    assert told == str(device)
    assert len(told) <= 160
    assert "\n" not in told
    assert name in told
    assert f"{device.channels} channels" in told
    html = device._repr_html_()
    ElementTree.fromstring(html)
    for text in (device.title, "Ω at", " continuous", "N·m, ", "°C", f"{len(device.assumed)} values"):
        assert text in html


def test_a_subclass_that_is_a_dataclass_shows_itself_alike() -> None:
    omni = haptorb.load("omni")

    @dataclass(frozen=True, kw_only=True)
    class Larger(type(omni)):  # type: ignore[misc]
        note: str = "x" * 1000

    larger = Larger(**vars(replace(omni, name="larger")))
    assert repr(larger).startswith("<Larger 'larger': 3 channels")


def test_a_state_shows_place_and_motion() -> None:
    assert repr(State.at((0, 0, 0.05))) == "<State at t = 0 s: p (0, 0, 50) mm, axis (0.000, 0.000, 1.000)>"
    moving = State.at((0.01, 0, 0.05), axis=(0, 0, 1), v=(0, 0.1, 0), w=(0, 0, 2.0), t=1.25)
    assert repr(moving).splitlines() == [
        "<State at t = 1.25 s: p (10, 0, 50) mm, axis (0.000, 0.000, 1.000)",
        " v (0, 100, 0) mm/s, w (0, 0, 2) rad/s>",
    ]
    html = moving._repr_html_()
    ElementTree.fromstring(html)
    assert "(0, 100, 0) mm/s" in html


def test_a_wrench_map_shows_force_and_torque_per_ampere() -> None:
    per_ampere = haptorb.wrench_map("omni", State.at((0, 0, 0.05)))
    told, html = repr(per_ampere), per_ampere._repr_html_()
    assert told.startswith("<WrenchMap of 3 channels: up to ")
    assert "mN/A" in told
    assert f"passive {1e3 * np.linalg.norm(per_ampere.passive[:3]):.3g} mN" in told
    table = ElementTree.fromstring(html)
    assert len(table.findall(".//tbody/tr")) == 6
    assert "T_z [mN·m/A]" in html
    assert f"{1e3 * per_ampere.matrix[2, 2]:.3g}" in html
    names = haptorb.load("omni").coils.names
    assert [head.text for head in table.findall(".//thead//th")] == [None, *names, "passive"]
