"""The hand from a file: parsing, rejected files, and reproducible runs, also when pushed by the world."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from haptorb.devices.loader import load
from haptorb.errors import HaptorbError, InputError
from haptorb.runtime.hand_file import choose_hand, parse_script, parse_table, read_hand
from haptorb.runtime.servo import Servo
from haptorb.simulation.hand_motion import ScriptedMotion
from oracles.recorded_chain import record_chain

OMNI, MOTOR = load("omni"), load("pmsm")
SCRIPT = """
# onto the dome, along it
start 0 0 62 mm
move 0 0 0.048 m in 0.2 s
press a c
wait 100 ms
release a
line 10 0 49 mm in 50 ms
grip 40 mm
grip 10 mm in 0.1 s
"""


def read(text: str, tmp_path: Path, name: str = "a.hand") -> ScriptedMotion:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return read_hand(path, OMNI)


def test_a_script_moves_with_the_least_jerk_and_presses(tmp_path: Path) -> None:
    motion = read(SCRIPT, tmp_path)
    assert motion.duration == pytest.approx(0.45)
    for t in (0.0, 0.03, 0.1, 0.17, 0.2):  # Flash and Hogan 1985, eq. 4 of a straight movement, at the samples of 1 ms
        s = t / 0.2
        z = 0.062 + (0.048 - 0.062) * (10 * s**3 - 15 * s**4 + 6 * s**5)
        assert motion.at(t)[0] == pytest.approx([0.0, 0.0, z], abs=1e-12)
        assert motion.at(t)[1] == pytest.approx([0.0, 0.0, 0.0, 1.0])
    assert motion.at(0.325)[0] == pytest.approx([0.005, 0.0, 0.0485])  # half of a straight line at constant speed
    axis = motion.at(0.35)[0] / np.linalg.norm(motion.at(0.35)[0])  # the tool is radial
    x, y, z, w = motion.at(0.35)[1]
    assert [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)] == pytest.approx(axis.tolist())
    assert [motion.signals_at(t)[0] for t in (0.199, 0.2, 0.299, 0.3, 9.0)] == [0, 5, 5, 4, 4]
    assert [round(motion.signals_at(t)[1], 6) for t in (0.35, 0.4, 9.0)] == [0.04, 0.025, 0.01]
    assert motion.at(9.0)[0].tolist() == motion.at(0.45)[0].tolist()


def test_a_table_has_units_and_straight_lines(tmp_path: Path) -> None:
    head = "t [ms]; x [mm]; y [m]; z [mm]; psi [°]; lambda [rad]; phi [°]; buttons; grip [mm]\n"
    motion = read(f"{head}0;0;0;60;0;0;0;;\n\n# a comment\n500;10;0.02;50;90;0;0;ab;30\n1000;10;0;50;0;0;0;2;10\n",
                  tmp_path, "a.csv")  # fmt: skip
    assert motion.at(0.25)[0] == pytest.approx([0.005, 0.01, 0.055])
    assert motion.at(0.5)[1] == pytest.approx([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])  # 90° about x
    assert [motion.signals_at(t)[0] for t in (0.4, 0.5, 1.0)] == [0, 3, 2]
    assert motion.signals_at(0.75)[1] == pytest.approx(0.02)
    motor = parse_table("t,qx,qy,qz,qw\n0,0,0,0,1\n1,0,0,1,0\n", MOTOR, "it")
    assert motor.at(1.0)[1] == pytest.approx([0.0, 0.0, 1.0, 0.0])


REFUSED = {
    "empty": ("", "empty"),
    "no start": ("move 0 0 50 mm in 1 s", "line 1"),
    "two starts": ("start 0 0 60 mm\nstart 0 0 60 mm", "line 2"),
    "no unit": ("start 0 0 60\n", "line 1"),
    "wrong unit": ("start 0 0 60 kg\n", "length"),
    "millimetres that are metres": ("start 0 0 60 m\n", "metres"),
    "no such command": ("start 0 0 60 mm\njump 0 0 50 mm in 1 s", "line 2"),
    "no such button": ("start 0 0 60 mm\npress d", "button"),
    "no time": ("start 0 0 60 mm\nwait 0 s", "duration"),
    "forever": ("start 0 0 60 mm\nwait 2 h", "3600"),
    "wide grip": ("start 0 0 60 mm\ngrip 1 m", "grip"),
    "not a number": ("start 0 0 nan mm", "line 1"),
    "time goes back": ("t [s],x [mm],y [mm],z [mm]\n0,0,0,60\n1,0,0,60\n0.5,0,0,60\n", "line 4: t must increase"),
    "time repeats": ("t,x,y,z\n0,0,0,0.06\n0,0,0,0.06\n", "line 3: t must increase"),
    "NaN time": ("t,x,y,z\nnan,0,0,0.06\n", "line 2"),
    "negative time": ("t,x,y,z\n-1,0,0,0.06\n", "line 2"),
    "NaN": ("t,x,y,z\n0,0,nan,0.06\n", "line 2: y"),
    "a hole": ("t,x,y,z\n0,0,,0.06\n", "line 2: y"),
    "infinite": ("t,x,y,z\n0,0,inf,0.06\n", "line 2: y"),
    "no number": ("t,x,y,z\n0,0,here,0.06\n", "line 2: y"),
    "millimetres": ("t,x,y,z\n0,0,0,60\n", "metres"),
    "forces": ("t [s],x [N],y [mm],z [mm]\n0,0,0,0.06\n", "column x"),
    "no place": ("t,grip\n0,0.1\n", "no pose"),
    "half a quaternion": ("t,qx,qy,qz\n0,0,0,0\n", "qw is missing"),
    "no unit quaternion": ("t,qx,qy,qz,qw\n0,0,0,0,3\n", "length 1"),
    "turned twice": ("t,qx,qy,qz,qw,psi,lambda,phi\n0,0,0,0,1,0,0,0\n", "twice"),
    "an unknown column": ("t,x,y,z,button\n0,0,0,0.06,a\n", "buttons"),
    "a column twice": ("t,x,y,z,z\n0,0,0,0.06,1\n", "twice"),
    "a wrong button": ("t,x,y,z,buttons\n0,0,0,0.06,d\n", "buttons"),
    "only a head": ("t,x,y,z\n", "no rows"),
    "an hour and more": ("t,x,y,z\n0,0,0,0.06\n3601,0,0,0.06\n", "3600"),
}


@pytest.mark.parametrize("title", REFUSED)
def test_what_is_no_motion_is_refused_in_words(title: str, tmp_path: Path) -> None:
    text, told = REFUSED[title]
    with pytest.raises(InputError) as refused:
        read(text, tmp_path)
    assert told in str(refused.value)
    assert "a.hand" in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1


def test_a_file_is_bounded_and_no_pipe(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="longer than"):
        read("t,x,y,z\n" + "0,0,0,0.06\n" * 3_500_000, tmp_path)
    with pytest.raises(InputError, match="rows"):
        parse_table("t,x,y,z\n" + "0,0,0,1\n" * 1_000_100, OMNI, "it")
    with pytest.raises(InputError, match="lines"):
        parse_script("start 0 0 60 mm\n" * 10_001, OMNI, "it")
    with pytest.raises(InputError, match="longer than"):
        parse_script("start 0 0 60 mm\n" + "move 0 0 50 mm in 900 s\n" * 2, OMNI, "it")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(HaptorbError, match="regular file"):
        read_hand(tmp_path / "pipe", OMNI)
    (tmp_path / "a.toml").write_text('kind = "spherical-motor"\n')
    with pytest.raises(HaptorbError, match="device file"):
        read_hand(tmp_path / "a.toml", OMNI)


def test_a_real_device_and_a_tracker_refuse_it(tmp_path: Path) -> None:
    (tmp_path / "a.hand").write_text(SCRIPT)
    for driver, tracker, told in (("serial:/dev/null", "pointer", "real tool"), ("sim", "osc:9000", "osc:9000")):
        with pytest.raises(InputError, match=told):
            choose_hand(tmp_path / "a.hand", OMNI, driver, tracker)
    with pytest.raises(InputError, match="real tool"):
        Servo("omni", driver="serial:/dev/null", hand=tmp_path / "a.hand")


def test_the_same_file_gives_the_same_run_and_a_recording_of_it_too(tmp_path: Path) -> None:
    """Bit for bit: of a script, of the recording of that run, and of its export as CSV in all printed digits."""
    motion = read(SCRIPT, tmp_path)
    first = record_chain(tmp_path / "a.mcap", ticks=500, hand=motion)
    again = record_chain(tmp_path / "b.mcap", ticks=500, hand=read(SCRIPT, tmp_path))
    replayed = record_chain(tmp_path / "c.mcap", ticks=500, hand=read_hand(tmp_path / "a.mcap", OMNI))
    first.to_csv(tmp_path / "a.csv")
    exported = record_chain(tmp_path / "d.mcap", ticks=500, hand=read_hand(tmp_path / "a.csv", OMNI))
    for name in ("hand_goal", "hand_goal_q", "p", "wrench_actual", "current_measured"):
        for other in (again, replayed, exported):
            assert np.array_equal(np.asarray(first[name]), np.asarray(other[name]), equal_nan=True), name
    force = np.linalg.norm(np.asarray(first["wrench_actual"])[:, :3], axis=1)
    assert force.max() > 0.1


def test_what_is_rendered_pushes_the_hand_away_from_its_goal(tmp_path: Path) -> None:
    """At rest the force of the device balances the spring of the hand: F = K (p − goal), of the device file's K."""
    text = "start 0 0 62 mm\nmove 0 0 52 mm in 0.3 s\nwait 1 s\n"
    run = record_chain(tmp_path / "a.mcap", ticks=1300, hand=read(text, tmp_path))
    late = slice(1200, 1300)
    force = np.asarray(run["wrench_actual"])[late, 2].mean()
    pushed = (np.asarray(run["p"]) - np.asarray(run["hand_goal"]))[late, 2].mean()
    stiffness = OMNI.hand.stiffness  # type: ignore[attr-defined]
    assert force > 0.1
    assert force == pytest.approx(stiffness * pushed, rel=0.03)


@pytest.mark.realtime
@pytest.mark.usefixtures("quick_starts")
def test_a_servo_plays_it_by_the_loops_clock_with_buttons_and_grip(tmp_path: Path) -> None:
    (tmp_path / "a.hand").write_text(SCRIPT)
    motion = read_hand(tmp_path / "a.hand", OMNI)
    with Servo("omni", hand=tmp_path / "a.hand", record=tmp_path / "run.mcap") as servo:
        servo.run(0.8)
        servo.hand.point((0.0, 0.0, 0.06), keep_alive=1.0)  # a person goes before the file
        servo.run(0.2)
        assert servo.latest().hand_goal.tolist() == [0.0, 0.0, 0.06]
        assert servo.latest().buttons == 0.0
    run = servo.recording
    assert run.metadata["run"]["hand"] == f"a.hand {motion.digest}"
    rows = np.flatnonzero((np.asarray(run["t"]) < 0.8) & (np.asarray(run["commands"]) >= 0))
    assert len(rows) > 100
    for n in rows[:: len(rows) // 100]:
        t = float(run["t"][n])
        place, turn = motion.at(t)
        assert np.array_equal(run["hand_goal"][n], place)
        assert np.array_equal(run["hand_goal_q"][n], turn)
        bits, grip = motion.signals_at(t)
        assert float(run["buttons"][n]) == bits
        assert np.array_equal(float(run["grip"][n]), grip, equal_nan=True)
    back = read_hand(tmp_path / "run.mcap", OMNI)
    assert [back.signals_at(t)[0] for t in (0.19, 0.22, 0.32)] == [0, 5, 4]
