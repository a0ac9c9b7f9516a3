"""Part of a wrench that worlds use, alone and in sums."""

import numpy as np
import pytest

from haptorb import worlds
from haptorb.errors import UnknownName
from haptorb.worlds.base import PARTS, check_part, find_part, join_parts
from haptorb.worlds.user_world import FunctionWorld


def test_every_world_of_the_catalogue_for_a_tool_says_what_it_asks():
    for name, kind in worlds.CATALOGUE.items():
        if not kind.needs_object:  # of a program, the commands show it
            assert kind().asks in PARTS or kind is worlds.Remote, name


def test_a_sum_asks_what_its_parts_ask():
    assert (worlds.Wall() + worlds.Magnet()).asks == "force"
    assert (worlds.Wall() + worlds.Compass()).asks == "both"
    own = FunctionWorld(lambda state: np.zeros(6))
    assert (worlds.Wall() + own).asks is None
    assert (worlds.CompassDome() + own).asks == "both"
    assert join_parts(["torque", "torque"]) == "torque"


def test_parts_are_found_in_wrenches_and_by_name():
    assert find_part(np.array([0, 1.0, 0, 0, 0, 0])) == "force"
    assert find_part(np.array([0, 1.0, 0, 0, 0, 1e-9])) == "both"
    assert find_part(np.zeros(6)) is None
    assert [check_part(part) for part in PARTS] == list(PARTS)
    with pytest.raises(UnknownName, match="did you mean 'both'"):
        check_part("boht")
