"""Bodies of worlds with memory, as sent to the page."""

from dataclasses import dataclass

from haptorb.devices.loader import load
from haptorb.web.session import list_shapes
from haptorb.worlds import RollingBall, Shape

OMNI = load("omni")


def test_a_body_says_where_its_numbers_are():
    (ball,) = list_shapes("ball", {"radius": 0.02}, {}, OMNI)
    assert {"name": "ball", "kind": "sphere", "size": [0.02], "place": 6, "attitude": None}.items() <= ball.items()
    key = list_shapes("button", {}, {}, OMNI)[0]
    assert (key["kind"], key["place"], key["attitude"]) == ("cylinder", 3, 6)


def test_other_worlds_have_none():
    assert (
        list_shapes("dome", {}, {}, OMNI)
        == list_shapes("somebody's", {}, {}, OMNI)
        == list_shapes("ball", {"mass": -1}, {}, OMNI)
        == []
    )


def test_own_worlds_have_theirs_and_their_mistakes_cost_only_the_picture():
    @dataclass(frozen=True)
    class LostBall(RollingBall):
        @property
        def shapes(self):
            return (Shape("ball", "sphere", (0.01,), "nowhere"),)

    own = {"mine": RollingBall(radius=0.015), "lost": LostBall()}
    assert list_shapes("mine", {}, own, OMNI)[0]["size"] == [0.015]
    assert list_shapes("lost", {}, own, OMNI) == []
