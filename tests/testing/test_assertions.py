"""Testing tools: reproducible runs, and assertions that fail with the location of the error."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptorb.devices.base import State
from haptorb.devices.loader import load
from haptorb.errors import InputError, RecordingError, UnknownName, WorldError
from haptorb.recording.recording import Recording
from haptorb.replay.replay import Replay
from haptorb.runtime.hand_file import parse_script
from haptorb.testing import (
    assert_force_within,
    assert_no_trip,
    assert_torque_within,
    haptic_device,
    scripted_hand,
)
from haptorb.worlds import Dome
from oracles.recorded_chain import record_chain

ONTO = "start 0 0 62 mm\nmove 0 0 50 mm in 0.3 s\npress b\nwait 0.3 s\n"
SPRING = 30.0  #: [N/m]


def spring(state: State) -> Any:
    """(6,) a spring towards the plane y = 0."""
    return np.array([0.0, -SPRING * state.p[1], 0.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def across(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A hand that goes across a spring, after the ramp of 0.3 s."""
    hand = scripted_hand([(0, 0, 0.052), (0, 0, 0.052), (0, 0.008, 0.052), (0, 0.008, 0.052)], [0.0, 0.4, 0.7, 1.0])
    with haptic_device("omni", spring, hand=hand, record=tmp_path_factory.mktemp("run") / "run.mcap") as run:
        run.play()
    assert run.t == pytest.approx(1.001)
    return run.recording


def test_a_run_is_that_of_the_loop_and_the_same_every_time(tmp_path: Path) -> None:
    """Beside the chain that the other tests step, with its own code."""
    first, again = tmp_path / "a.mcap", tmp_path / "b.mcap"
    for file in (first, again):
        with haptic_device("omni", "dome", hand=scripted_hand(ONTO), seed=7, record=file) as run:
            run.play(0.5)
    one, two = Recording(first), Recording(again)
    other = record_chain(tmp_path / "c.mcap", ticks=500, hand=parse_script(ONTO, load("omni"), "it"))
    assert len(one) == len(two) == 500
    for name in ("t", "p", "wrench_actual", "current_measured", "winding", "hand_goal"):
        assert np.array_equal(one[name][:], two[name][:], equal_nan=True), name
        assert np.allclose(one[name][:], other[name][:], rtol=0, atol=1e-9, equal_nan=True), name
    assert [int(one["buttons"][n]) for n in (299, 300)] == [0, 2]
    assert Replay(one).run().identical


def test_a_recording_replaces_a_link_and_does_not_follow_it(tmp_path: Path) -> None:
    precious, file = tmp_path / "precious", tmp_path / "run.mcap"
    precious.write_text("mine")
    file.symlink_to(precious)
    with haptic_device("omni", "dome", hand=scripted_hand(ONTO), record=file) as run:
        run.play(0.01)
    assert len(run.recording) == 10
    assert precious.read_text() == "mine"


def test_the_force_of_the_reference_passes_in_each_of_its_forms(across: Recording) -> None:
    times = {"between": (0.4, 1.0)}
    assert np.abs(across["wrench_actual"][:, 1]).max() > 0.1
    for reference in (spring, lambda s: (0.0, -SPRING * s.p[1], 0.0), across, across["object_wrench"][:, :3]):
        assert_force_within(across, reference, newtons=0.01, share=0.05, **times)
    assert_force_within(across.path, spring, newtons=0.01, share=0.05, **times)
    assert_force_within(across, spring, newtons=1e-9, wrench="object_wrench", between=(0.4, 1.0))
    assert_torque_within(across, (0, 0, 0), newton_metres=1e-12, wrench="object_wrench")
    assert_no_trip(across)


def test_what_is_wrong_is_stated_with_time_place_and_size(across: Recording) -> None:
    def stiffer(state: State) -> Any:
        return 0.0, -2.0 * SPRING * state.p[1], 0.0

    with pytest.raises(AssertionError) as told:
        assert_force_within(across, stiffer, newtons=0.02, between=(0.4, 1.0))
    text = str(told.value)
    t, p, force = across["t"][:], across["p"][:], across["wrench_actual"][:, :3]
    wanted = np.column_stack([0 * t, -2.0 * SPRING * p[:, 1], 0 * t])
    distance = np.linalg.norm(force - wanted, axis=1)[t >= 0.4]
    worst, count = int(np.argmax(distance)) + 400, int((distance > 0.02).sum())
    assert f"in {count} of 601 ticks" in text
    assert f"worst at {t[worst]:.4g} s (tick {worst}): {distance.max():.4g} N, most of it along y" in text
    assert f"{1e3 * p[worst, 1]:.4g}" in text
    files = [Path(one) for one in re.findall(r"(?:table|figure) (\S+)", text)]
    assert [file.suffix for file in files] == [".csv", ".png"]
    table = np.loadtxt(files[0], delimiter=",", skiprows=1)
    assert table.shape == (601, 8)
    assert table[:, 4:7] == pytest.approx(wanted[400:], abs=1e-6)
    assert files[1].stat().st_size > 5000


def test_the_ramp_and_an_unknown_force_are_no_match(across: Recording, tmp_path: Path) -> None:
    with haptic_device("omni", "dome", hand=scripted_hand("start 0 0 50 mm\nwait 0.2 s")) as run:
        run.play()
    with pytest.raises(AssertionError, match=r"from 0(\.\d+)? s to .*\n.*\n.*\n.*guard ramping"):
        assert_force_within(run.recording, "dome", newtons=0.05)

    def lose(rows: Any) -> None:
        layout = run.latest().layout
        rows[50, layout["wrench_actual"]] = rows[50, layout["wrench_model"]] = np.nan

    lost = record_chain(tmp_path / "a.mcap", ticks=60, change=lose)
    with pytest.raises(AssertionError, match="in 1 of 60 ticks"):
        assert_force_within(
            lost, np.where(np.isnan(lost["wrench_actual"][:, :3]), 0.0, lost["wrench_actual"][:, :3]), newtons=0.0
        )


def test_a_trip_is_found(tmp_path: Path) -> None:
    stopped = record_chain(tmp_path / "a.mcap", ticks=60, deeds={30: lambda tick: tick.stop()})
    with pytest.raises(AssertionError, match=r"at 0.03 s: Stopped by hand"):
        assert_no_trip(stopped)
    assert_no_trip(stopped, between=(0.0, 0.029))


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda run: assert_force_within(run, (0, 0), newtons=1.0), "shape"),
        (lambda run: assert_force_within(run, "dome", newtons=1.0, between=(8.0, 9.0)), "no tick"),
        (lambda run: assert_force_within(run, "dome", newtons=-1.0), "tolerances"),
        (lambda run: assert_force_within(run, "dome", newtons=1.0, wrench="felt"), "wrench_actual"),
        (lambda run: assert_force_within(run, "button", newtons=1.0), "memory"),
        (lambda run: assert_force_within(run, "domme", newtons=1.0), "dome"),
        (lambda run: assert_force_within("/nowhere.mcap", "dome", newtons=1.0), "nowhere"),
    ],
)
def test_a_comparison_that_makes_no_sense_is_refused(
    across: Recording, call: Callable[[Recording], None], told: str
) -> None:
    with pytest.raises((InputError, UnknownName, RecordingError), match=told):
        call(across)


def test_a_run_that_makes_no_sense_is_refused() -> None:
    with pytest.raises(InputError, match="times"):
        scripted_hand([(0, 0, 0.05)])
    with pytest.raises(InputError, match="states its own"):
        scripted_hand(ONTO, [0.0])
    with pytest.raises(InputError, match="real_time"), haptic_device(serve=["haply"]):
        pass
    with pytest.raises(InputError, match="line 1"), haptic_device(hand=scripted_hand("start here\n")):
        pass
    with haptic_device("omni") as run:
        for seconds in (-1.0, float("nan"), None):
            with pytest.raises(InputError):
                run.play(seconds)
        with pytest.raises(InputError, match="no tick"):
            run.latest()


def test_a_world_that_fails_ends_the_run_in_words() -> None:
    def failing(state: State) -> Any:
        if state.t > 0.1:
            raise ZeroDivisionError("on purpose")
        return np.zeros(6)

    with (
        haptic_device("omni", failing) as run,
        pytest.raises(WorldError, match=r"(?s)at 0\.10\d s.*on purpose.*coils are off"),
    ):
        run.play(0.2)
    assert 100 <= len(run.recording) <= 103


def test_a_world_is_changed_between_two_ticks() -> None:
    with haptic_device("omni", Dome(), hand=scripted_hand("start 0 0 49 mm")) as run:
        run.play(0.5)
        before = run.latest().wrench_actual[2]
        run.set_world("dome", moment=1.2)
        run.play(0.5)
        after = run.latest().wrench_actual[2]
        with pytest.raises(UnknownName):
            run.set_world("dom")
    assert abs(after) < 0.8 * abs(before)
    assert Replay(run.recording).run().identical


def run_pytest(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """pytest in a process of its own, with our fixtures as an installation has them."""
    known = any(one.value == "haptorb.testing.fixtures" for one in entry_points(group="pytest11"))
    plugin = [] if known else ["-p", "haptorb.testing.fixtures"]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *plugin, *words, str(folder)]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ, cwd=folder)


@pytest.mark.slow
def test_the_example_is_a_suite_that_passes(root: Path) -> None:
    done = run_pytest(root / "examples" / "testing")
    assert done.returncode == 0, done.stdout
    assert "2 passed" in done.stdout


@pytest.mark.slow
@pytest.mark.realtime
def test_in_real_time_the_force_is_that_of_the_stepped_loop(tmp_path: Path) -> None:
    hand = scripted_hand(ONTO)
    with haptic_device("omni", "dome", hand=hand, record=tmp_path / "stepped.mcap") as stepped:
        stepped.play()
    with haptic_device("omni", "dome", hand=hand, real_time=True, record=tmp_path / "real.mcap") as real:
        real.play()
        assert real.t > 0.3
    last = min(float(real.recording["t"][-1]), 0.6)
    assert last > 0.5
    assert_force_within(real.recording, stepped.recording, newtons=0.01, between=(0.35, last))
