"""A world with a client's force keeps name, parameters and that force through every change."""

from __future__ import annotations

import json

import pytest

from haptorb.errors import InputError
from haptorb.runtime.world_requests import change_world, description, name_of, values_of
from haptorb.worlds import Dome, Remote, RollingBall, Wall
from haptorb.worlds.client_force import split_remote


def test_name_and_values_are_those_of_the_world() -> None:
    world = Dome(moment=1.0) + Remote(limit=3.0)
    assert name_of(world) == "dome"
    assert values_of(world)["moment"] == 1.0
    note = json.loads(description(world))
    assert (note["name"], note["remote"]["limit"]) == ("dome", 3.0)
    assert any(field["name"].endswith("session") for field in note["memory"])
    assert "remote" not in json.loads(description(Dome()))


def test_a_change_of_values_or_world_keeps_the_clients_force() -> None:
    world = Dome() + Remote(limit=3.0)
    changed = change_world(world, "dome", {"moment": 1.5})
    assert split_remote(changed) == (Dome(moment=1.5), Remote(limit=3.0))
    assert split_remote(change_world(changed, "wall", {"stiffness": 90.0})) == (Wall(stiffness=90.0), Remote(limit=3.0))
    assert split_remote(change_world(changed, "ball", {})) == (RollingBall(), Remote(limit=3.0))
    assert change_world(world, "dome", {}) is world
    assert change_world(world, "remote", {}) == Remote()


def test_a_value_that_cannot_be_is_refused_as_without() -> None:
    with pytest.raises(InputError, match="moment"):
        change_world(Dome() + Remote(), "dome", {"moment": 1e9})


def test_the_client_alone_and_other_sums_are_what_they_are() -> None:
    assert split_remote(Remote()) == (Remote(), None)
    both = Dome() + Wall()
    assert split_remote(both) == (both, None)
    assert name_of(both + Remote()) == "sum"
