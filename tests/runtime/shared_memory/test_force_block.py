"""Clients' forces in shared memory: commanding client, age of a command, and data of an ended writer."""

from __future__ import annotations

import pytest

from haptorb.runtime.shared_memory import BLOCKS, ClientForces, ForceBlock
from haptorb.runtime.shared_memory import FORCE_BLOCK_WORDS as WORDS
from haptorb.worlds.client_force import FADE_TIME_S, HOLD_TIME_S
from haptorb.worlds.dynamic import make_client_force


@pytest.fixture
def page():
    memory = memoryview(bytearray(8 * WORDS * BLOCKS))
    return memory.cast("q"), memory.cast("d")


def read(page, now, forces=None):
    client = make_client_force()
    (forces or ClientForces(*page, 0)).fill(client, now)
    return client[0]


def test_nobody_has_commanded(page):
    client = read(page, 5.0)
    assert client["session"] == 0
    assert not client["force"].any()


def test_a_command_has_its_age_and_its_session(page):
    ForceBlock(*page, 0).command((1.0, 2.0, 3.0), 7, 10.0)
    client = read(page, 10.25)
    assert client["force"].tolist() == [1.0, 2.0, 3.0]
    assert (client["session"], client["age"], client["lost"]) == (7.0, 0.25, 0.0)
    assert read(page, 9.0)["age"] == 0.0  # stamped while the tick had begun


def test_a_lost_connection_keeps_its_first_time_and_ends_with_a_new_command(page):
    block = ForceBlock(*page, 0)
    block.command((0.0, 0.0, 1.0), 7, 10.0)
    block.lose(10.1)
    block.lose(10.5)
    assert read(page, 10.6)["lost"] == pytest.approx(0.5)
    block.command((0.0, 0.0, 2.0), 8, 11.0)
    assert read(page, 11.0)["lost"] == 0.0


def test_the_first_of_two_servers_holds_the_device_until_its_force_has_faded(page):
    first, second = (ForceBlock(*page, WORDS * n) for n in (0, 5))
    forces = ClientForces(*page, 0)
    first.command((1.0, 0.0, 0.0), 1, 10.0)
    assert read(page, 10.0, forces)["session"] == 1
    second.command((2.0, 0.0, 0.0), 2, 10.05)
    assert read(page, 10.06, forces)["session"] == 1
    assert read(page, 10.0 + HOLD_TIME_S + FADE_TIME_S + 1e-6, forces)["session"] == 2
    second.lose(10.08)
    first.command((3.0, 0.0, 0.0), 1, 10.085)
    assert read(page, 10.09, forces)["session"] == 2
    assert read(page, 10.08 + FADE_TIME_S + 1e-6, forces)["session"] == 1


def test_a_writer_that_died_in_the_middle_leaves_its_last_whole_command_which_grows_old(page):
    words, floats = page
    block, forces = ForceBlock(words, floats, 0), ClientForces(words, floats, 0)
    block.command((1.0, 0.0, 0.0), 1, 10.0)
    read(page, 10.0, forces)
    words[0] |= 1
    floats[1] = 99.0
    client = read(page, 10.5, forces)
    assert client["force"].tolist() == [1.0, 0.0, 0.0]
    assert client["age"] == 0.5
