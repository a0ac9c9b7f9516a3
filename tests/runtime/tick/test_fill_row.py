"""Contact data in a row: written where the layout has fields for them, and nowhere else."""

import numpy as np
import pytest

from haptorb.devices.loader import load
from haptorb.recording.row import RowLayout
from haptorb.runtime.tick import fill_object

TWO = np.arange(1.0, 17.0).reshape(2, 8)


@pytest.mark.parametrize("room", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [0, 1, 2])
def test_contacts_fill_their_field_and_nothing_beyond(room: int, count: int) -> None:
    layout = RowLayout(channels=3, sensors=1, contacts=room)
    row = np.full(layout.width, 7.0)
    fill_object(
        row, layout.places, np.ones(2), np.ones(3), np.eye(3), np.ones(6), TWO[:count], np.empty(0), np.empty(30)
    )
    contacts = row[layout["contacts"]].reshape(room, 8)
    there = min(room, count)
    assert (contacts[:there] == TWO[:there]).all()
    assert not contacts[there:].any()
    assert (row[layout["energy"].start :] == 7.0).all()


def test_a_kind_says_how_many_contacts_its_rows_have() -> None:
    assert RowLayout.of(load("omni")).contacts == 0
    assert RowLayout.of(load("pmsm")).contacts == 2


def test_all_layouts_share_one_type_of_places() -> None:
    """Compiled code compares types by identity first: equal ones cost every tick."""
    assert RowLayout.of(load("omni")).places.dtype is RowLayout.of(load("pmsm"), 64).places.dtype
