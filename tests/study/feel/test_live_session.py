"""A running feel session: one state for page and terminal, durable ratings, an order per person."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import haptorb_study.feel
from haptorb.analysis.stability import MIN_STABILITY_MARGIN
from haptorb.control.linkage import MOTOR_GAINS
from haptorb.devices.loader import load
from haptorb.errors import InputError, UnknownName
from haptorb.recording.row import RowLayout
from haptorb_study.feel import FeelSession, course, load_designs
from haptorb_study.feel.limits import find_limits
from haptorb_study.feel.live_session import FeelPanel, LiveSession, execute_line, read_lines, world_key
from haptorb_study.feel.torque_scale import ScaleLimits, TrueScale

EXAMPLE = Path(haptorb_study.feel.__file__).with_name("example.toml")


class Servo:
    """Rows as a servo publishes them, each with the number of its world."""

    layout = RowLayout.of(load("pmsm"))

    def __init__(self) -> None:
        self.worlds: list[tuple[str, Any]] = []
        self.kept: list[np.ndarray] = []
        self.moving = False  # a hand that moves whatever is rendered

    def set_world(self, name: str, given: Any = None) -> None:
        self.worlds.append((name, given))

    def set_torque_scale(self, scale: float) -> None:
        self.scale = scale

    def tick(self, x: float, n: int = 1) -> None:
        row = self.layout.empty()
        row[:] = 0.0
        for name, value in {
            "valid": 1.0,
            "world": len(self.worlds),
            "object": (x, 0, 0),
            "object_q": (0, 0, 0, 1),
        }.items():
            row[self.layout[name]] = value
        self.kept += [row] * n

    def rows(self, cursor: int = 0) -> tuple[int, np.ndarray]:
        if self.moving:
            self.tick(0.0)
            self.tick(1e-3)
        return len(self.kept), np.array(self.kept[cursor:]).reshape(-1, self.layout.width)


@pytest.fixture
def kept(tmp_path: Path) -> FeelSession:
    return FeelSession(tmp_path / "s", load_designs(EXAMPLE))


def start(kept: FeelSession, *, moving: bool = False, **options: Any) -> tuple[LiveSession, Servo]:
    live, servo = LiveSession(kept, list(kept.candidates.designs), seed=1, **options), Servo()
    servo.moving = moving
    live.attach(servo)
    return live, servo


def test_everybody_is_offered_every_design_once_before_any_twice(kept: FeelSession) -> None:
    live, servo = start(kept, person="P1", moving=True)
    felt = []
    for score in (1, 2, 3, 4):
        felt.append(live.current.name)
        live.rate(score)
        live.feel_next()
    assert sorted(felt) == sorted(design.name for design in kept.candidates.designs)
    names = [design.name for design in kept.candidates.designs]
    assert [servo.worlds[k - 1][0] for k in (1, 2, 3)] == [world_key(names.index(felt[k])) for k in (1, 2, 3)]
    assert {name: count for name, (count, _) in kept.scores("P1").items()} == dict.fromkeys(felt, 1)
    again, _ = start(
        kept, person="P1", moving=True
    )  # another day: nothing is lost, and nothing is asked twice without need
    assert [one["score"] is not None for one in again.describe()["designs"]] == [True] * 4
    again.set_person("P2")
    assert [one["score"] for one in again.describe()["designs"]] == [None] * 4
    again.rate(7)
    assert kept.scores("P1")[again.current.name][0] == 1
    assert kept.scores("P2")[again.current.name] == (1, 7.0)
    assert kept.people() == ("P1", "P2")


def test_a_session_goes_on_with_what_was_not_rated(kept: FeelSession) -> None:
    for design in kept.candidates.designs[:3]:
        kept.rate(design.name, 4, person="P1")
    live, _ = start(kept, person="P1")
    assert live.current.name == "slender"


def test_a_design_is_rated_only_once_it_was_felt(kept: FeelSession) -> None:
    live, servo = start(kept)
    servo.tick(0.0, 100)  # rendered, and not touched
    for _ in range(2):
        with pytest.raises(InputError, match="has not been felt"):
            live.rate(5)
        assert not live.describe()["felt"]
    servo.tick(0.4e-3)
    with pytest.raises(InputError, match="has not been felt"):
        live.rate(5)
    servo.tick(0.6e-3)
    live.rate(5)
    assert live.describe()["felt"]
    live.feel_next()  # what was felt of the one before does not count for this one
    servo.tick(0.6e-3)
    with pytest.raises(InputError, match="has not been felt"):
        live.rate(5)
    assert [one.score for one in kept.ratings()] == [5]


def test_a_second_thought_replaces_the_first_and_a_late_score_is_refused(kept: FeelSession) -> None:
    live, _ = start(kept, moving=True)
    shown = live.describe()["feeling"]
    live.rate(3, shown)
    live.rate(5, shown)
    assert [one.score for one in kept.ratings()] == [5]
    live.feel_next()  # somebody else was quicker
    with pytest.raises(InputError, match="another design was chosen"):
        live.rate(6, shown)
    assert len(kept.ratings()) == 1


def test_wrong_scores_change_nothing(kept: FeelSession) -> None:
    live, _ = start(kept)
    before = live.describe()
    for wrong in (0, 8, -1, 3.0, "5", True, None, 10**30):
        with pytest.raises(InputError, match="whole number from 1 to 7"):
            FeelPanel(live).execute({"act": "rate", "score": wrong, "feeling": before["feeling"]})
    for number in (0, 5, "1", None):
        with pytest.raises(UnknownName):
            FeelPanel(live).execute({"act": "feel", "number": number})
    for command in ({"act": "dance"}, {}, {"act": "pair", "slot": "c", "number": 1}, {"act": ["rate"]}):
        with pytest.raises(InputError):
            FeelPanel(live).execute(command)
    with pytest.raises(InputError, match="code"):
        FeelPanel(live).execute({"act": "person", "person": "x" * 41})
    assert live.describe() == before
    assert kept.ratings() == ()


def test_nothing_that_a_page_gets_tells_a_hidden_design(kept: FeelSession) -> None:
    live, _ = start(kept, blind=True, person="P1", moving=True)
    told = str(live.describe())
    for design in kept.candidates.designs:
        assert design.name not in told
        assert design.title not in told
    live.rate(2)
    assert kept.ratings()[0].blind
    FeelPanel(live).execute({"act": "hide", "hide": False})
    assert live.describe()["label"] == live.current.title
    order = [one["label"] for one in live.describe()["designs"]]
    live.feel_next()
    live.rate(7)
    FeelPanel(live).execute({"act": "hide", "hide": True})  # what was rated openly would tell which it is
    assert [one["score"] for one in live.describe()["designs"] if one["score"] is not None] == [2]
    FeelPanel(live).execute({"act": "hide", "hide": False})
    assert sorted(one["label"] for one in live.describe()["designs"]) == sorted(order)


def test_a_and_b_are_felt_by_their_slot(kept: FeelSession) -> None:
    live, _ = start(kept)
    FeelPanel(live).execute({"act": "pair", "slot": "a", "number": 3})
    FeelPanel(live).execute({"act": "pair", "slot": "b", "number": 1})
    FeelPanel(live).execute({"act": "slot", "slot": "a"})
    first = live.describe()
    assert (first["a"], first["b"], first["number"]) == (3, 1, 3)
    execute_line(live, "b")
    assert live.describe()["number"] == 1


def test_every_design_felt_has_its_own_trace_rated_or_not(kept: FeelSession) -> None:
    live, servo = start(kept, person="P1")
    felt = [live.current.name]
    servo.tick(1e-3, 5)
    live.collect()
    servo.tick(1e-3, 2)
    live.feel_next()
    felt.append(live.current.name)
    servo.tick(2e-3, 3)
    live.collect()
    live.close()
    rows = {one.design: kept.trace(one.trace) for one in kept.feelings()}
    assert [len(rows[name]) for name in felt] == [7, 3]
    assert (rows[felt[1]][:, 1] == 2e-3).all()
    assert {one.person for one in kept.feelings()} == {"P1"}


def test_the_terminal_asks_again_and_ends(kept: FeelSession) -> None:
    live, _ = start(kept, moving=True)
    lines, told = iter(["8", "0", "x", "", "person P9", "6", "end", "7"]), []
    read_lines(live, lines, told.append)
    assert len(told) == 3
    assert [(one.score, one.person) for one in kept.ratings()] == [(6, "P9")]
    assert next(lines) == "7"  # nothing is read after the end
    with pytest.raises(InputError, match="has ended"):
        live.rate(7)


def test_a_folder_of_other_designs_is_refused(kept: FeelSession, tmp_path: Path) -> None:
    kept.rate("firm", 4)
    other = tmp_path / "other.toml"
    text = EXAMPLE.read_text()
    for name in ("plain", "firm", "gentle", "slender"):
        text = text.replace(f"[design.{name}]", f"[design.new-{name}]")
    other.write_text(text)
    with pytest.raises(InputError, match=r"firm.*none of which is in this file.*--session"):
        FeelSession(kept.folder, load_designs(other))
    assert len(kept.ratings()) == 1


def test_the_gain_goes_as_far_as_stability_and_device_allow(kept: FeelSession) -> None:
    live, servo = start(kept)
    for wrong in (1.5, 0.0, -1, float("nan"), "1", True, None):  # nobody knows yet what is stable
        with pytest.raises(InputError, match="torque scale"):
            FeelPanel(live).execute({"act": "scale", "scale": wrong})
    assert not hasattr(servo, "scale")
    live.set_limits(ScaleLimits(2.2, "the stability check allows 2.2"))
    FeelPanel(live).execute({"act": "scale", "scale": 2})
    assert servo.scale == 2.0
    assert live.describe()["torque_scale"]["hand"] == pytest.approx(0.4)
    with pytest.raises(InputError, match="stability check allows"):
        live.set_scale(2.3)
    servo.tick(1e-3)
    live.collect()
    live.close()
    assert [one.scale for one in kept.feelings()] == [2.0]


def test_the_true_scale_and_its_limits() -> None:
    scale = TrueScale.of(load("pmsm"), MOTOR_GAINS)
    assert scale.hand_per_part == pytest.approx(0.2)
    assert "1 N at the part is 0.2 N in the hand" in scale.sentence
    designs = load_designs(EXAMPLE).designs
    peak = max(course(design).coming_out.max() for design in designs)
    saturating = find_limits(scale, designs, margin=1e3)
    assert saturating.largest * scale.lever * peak == pytest.approx(load("pmsm").limits.torque)
    assert "N·m" in saturating.reason
    stable = find_limits(scale, designs, margin=3.0)
    assert stable.largest == pytest.approx(3.0 / MIN_STABILITY_MARGIN)
    assert "vibrates" in stable.reason
    assert find_limits(scale, designs, None).largest == 1.0
    already = find_limits(scale, designs, margin=0.6)
    assert already.largest == 1.0
    assert "force_scale of the snap-fit file is too large" in already.reason
    with pytest.raises(InputError, match="works for spherical motors"):
        TrueScale.of(load("omni"), MOTOR_GAINS)
