"""`haptorb check --world`: verdict from the loop, confirmed by the simulated chain; mistakes are named."""

import json
import re
from dataclasses import replace

import pytest

from haptorb import worlds
from haptorb.analysis.stability import GRIPS, HandGrip
from haptorb.cli import main
from haptorb.cli.check_world import Setting, boundary, draw_world, is_growing, judge_world
from haptorb.devices.loader import load
from haptorb.errors import InputError

OMNI = load("omni")
LATE = Setting(1000.0, 240.0, 5e-3)


@pytest.mark.parametrize(
    ("rate", "tracker_rate", "latency", "grip"),
    [
        pytest.param(1000.0, None, 0.0, "light", marks=pytest.mark.slow),
        pytest.param(1000.0, 240.0, 5e-3, "firm", marks=pytest.mark.slow),
        (1000.0, 120.0, 10e-3, "loose"),
    ],
)
def test_the_simulated_boundary_is_within_15_percent(rate, tracker_rate, latency, grip):
    """Of the exact boundary and of the rough condition, for the whole chain with coils, drive, guard and magnets."""
    setting = Setting(rate, tracker_rate, latency, grip, GRIPS[grip])
    loop, hand = setting.loop(OMNI), GRIPS[grip].with_mass(OMNI.tool.mass)
    found = boundary(OMNI, GRIPS[grip], loop.largest(hand), rate, tracker_rate, latency, precision=0.04)
    assert found == pytest.approx(loop.largest(hand), rel=0.15)
    assert found == pytest.approx(loop.delay_bound(hand.damping), rel=0.15)


def test_the_hall_trackers_filter_is_part_of_the_loop():
    """It halves what can be rendered, as the eigenvalues say and as the simulated chain does."""
    plain, filtered = Setting(), Setting(bandwidth=100.0)
    hand = GRIPS["light"].with_mass(OMNI.tool.mass)
    expected = filtered.loop(OMNI).largest(hand)
    assert expected < 0.6 * plain.loop(OMNI).largest(hand)
    assert is_growing(OMNI, GRIPS["light"], 1.15 * expected, 1000.0, None, 0.0, hall=True)
    assert not is_growing(OMNI, GRIPS["light"], 0.85 * expected, 1000.0, None, 0.0, hall=True)


def test_a_world_outside_does_oscillate_and_its_advice_cures_it():
    """A wall of 400 N/m under a tracker of 240 Hz and 5 ms; with half of it the loop is quiet."""
    verdict = judge_world(OMNI, worlds.Wall(stiffness=400.0, damping=0.0, greatest=20.0), LATE)
    assert (verdict.verdict, verdict.fit) == ("outside", False)
    assert verdict.margin == pytest.approx(verdict.largest / 400.0, rel=1e-3)
    assert is_growing(OMNI, GRIPS["light"], 400.0, 1000.0, 240.0, 5e-3)
    assert not is_growing(OMNI, GRIPS["light"], 0.66 * verdict.largest, 1000.0, 240.0, 5e-3)
    advice = {text.split()[0]: float(re.search(r"[\d.]+", text)[0]) for text in verdict.advice}
    weaker, firmer = advice["Make"], advice["Hold"]
    assert judge_world(OMNI, worlds.Wall(stiffness=400.0 / weaker, damping=0.0, greatest=20.0), LATE).margin > 1.49
    held = replace(LATE, hand=HandGrip(0.1, firmer, 100.0))
    assert judge_world(OMNI, worlds.Wall(stiffness=400.0, damping=0.0, greatest=20.0), held).margin > 1.45


def test_advice_on_the_tracker():
    words = " ".join(judge_world(OMNI, worlds.Wall(stiffness=250.0, damping=0.0, greatest=20.0), LATE).advice)
    assert re.search(r"latency to [0-4]\.\d ms", words)
    assert re.search(r"tracker of \d+ Hz", words) is None  # at 5 ms no rate is enough by itself


def test_margins_and_words():
    quiet = judge_world(OMNI, worlds.Dome(), LATE)
    assert quiet.verdict == "inside"
    assert quiet.advice == ()
    assert 20.0 < quiet.steep.stiffness < 100.0
    assert quiet.steep.jump == pytest.approx(OMNI_JUMP, rel=0.2)
    close = judge_world(OMNI, worlds.Wall(stiffness=215.0, greatest=20.0), LATE)
    assert close.verdict == "close"
    assert close.fit
    assert close.advice
    nothing = judge_world(OMNI, worlds.Nothing(), LATE)
    assert nothing.margin == float("inf")
    assert nothing.numbers()["margin"] is None


#: the dome's tangential force where it is cut off at 54°: F0 sin 270°
OMNI_JUMP = abs(worlds.Dome().for_device(OMNI).strength)


@pytest.mark.parametrize(
    ("name", "world"), [("planar", worlds.Wall()), pytest.param("tetrahedron", worlds.Dome(), marks=pytest.mark.slow)]
)
def test_a_coil_array_is_judged_over_its_plate_or_dome(name, world):
    device = load(name)
    verdict = judge_world(device, world, Setting())
    assert verdict.fit
    assert verdict.steep.stiffness > 0.0
    assert verdict.hand.mass == pytest.approx(GRIPS["light"].mass + device.tool.mass)
    stiff = judge_world(device, worlds.Wall(stiffness=5000.0, greatest=20.0), LATE)
    assert not stiff.fit
    above = stiff.place.places[1::4]  # not those in contact, on the very edge
    assert all(stiff.place.inside(p) for p in above)
    turning = judge_world(device, worlds.Compass(), Setting())
    assert (turning.part, turning.place.length) == ("torque", "rad")
    assert turning.hand.damping == pytest.approx(device.hand.turn_damping)


def test_a_motor_is_judged_in_radians():
    verdict = judge_world(load("pmsm"), worlds.SnapFit(), Setting())
    assert verdict.numbers()["unit"] == "N·m/rad"
    assert verdict.steep.stiffness > 0.0


def test_a_latency_beyond_the_guards_expiry_is_refused():
    with pytest.raises(InputError, match="50 ms"):
        judge_world(OMNI, worlds.Dome(), Setting(latency=0.06))


def test_the_plot_is_drawn(tmp_path):
    verdict = judge_world(OMNI, worlds.Detents(), LATE)
    assert draw_world(verdict, tmp_path / "z.png", [(2.0, 250.0)]).stat().st_size > 20_000


def code_of(arguments):
    """The program's exit code, however it ends."""
    with pytest.raises(SystemExit) as ended:
        raise SystemExit(main(arguments))
    return ended.value.code or 0


def test_the_command(capsys):
    assert code_of(["check", "--world", "magnet", "--tracker-rate", "240", "--latency", "5", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["verdict"] == "inside"
    assert told["largest_exact"] == pytest.approx(259.0, abs=2.0)
    assert code_of(["check", "--world", "wall", "--set", "stiffness=5000", "--set", "greatest=20"]) == 1
    assert "Outside" in capsys.readouterr().out
    late = ["--tracker-rate", "120", "--latency", "10"]
    assert code_of(["check", "--world", "wall", *late, "--grip", "0.1,0,100"]) == 1  # beyond any stability
    assert "no stiffness at all is stable" in " ".join(capsys.readouterr().out.split())
    assert code_of(["check", "--world", "magnet", "--tracker", "hall:60"]) == 0
    assert "filtered to 60 Hz" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--world", "wal"], "wall"),
        (["--world", "wall", "--grip", "tight"], "MASS,DAMPING,STIFFNESS"),
        (["--world", "wall", "--latency", "-1"], "--latency"),
        (["--world", "wall", "--tracker-rate", "0"], "--tracker-rate"),
        (["--world", "wall", "--set", "stiffness=a"], "--set"),
        (["--world", "wall", "--plot", "figure.txt"], "--plot"),
        (["--latency", "5"], "--world"),
        (["--tracker", "hall"], "--world"),
        (["--world", "wall", "--tracker", "osc"], "--tracker must be hall"),
        (["--world", "wall", "--tracker", "hall:fast"], "--tracker must be hall"),
        (["--world", "wall", "--tracker", "hall:0"], "bandwidth"),
        (["--world", "wall", "--tracker", "hall", "--tracker-rate", "240"], "leave out --tracker-rate"),
        (["--world", "snap_fit", "--device", "pmsm", "--tracker", "hall"], "pmsm"),
    ],
)
def test_mistakes_are_named(arguments, word, capsys):
    code = code_of(["check", *arguments])
    said = capsys.readouterr().err
    assert code == 2
    assert word in said
    assert "Traceback" not in said
