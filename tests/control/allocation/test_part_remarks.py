"""Remarks on the rendered part of a wrench, against the allocators' results."""

import re

import numpy as np
import pytest

from haptorb.control.allocation import part_remarks, tool_choice
from haptorb.devices.base import State
from haptorb.devices.loader import load


@pytest.mark.parametrize("name", ["omni", "omni-fingertip"])
def test_the_figures_are_those_of_the_dipole_model(name):
    device = load(name)
    choice = tool_choice(device)
    text = part_remarks(device, choice)[1]
    torque, force = (float(found) for found in re.findall(r"([\d.]+) (?:mN·m|N\.)", text))
    over = device.wrench_map(State.at((0, 0, device.contact_distance)), "published")
    most = max(
        (over.matrix @ choice.allocators["torque"].allocate(over, np.r_[np.zeros(3), 10.0 * axis]).currents
         for axis in np.eye(3)[:2]),
        key=lambda wrench: np.linalg.norm(wrench[3:]),
    )  # fmt: skip
    assert torque == pytest.approx(1e3 * np.linalg.norm(most[3:]), rel=0.06)
    assert force == pytest.approx(np.linalg.norm(most[:3]), rel=0.06)


def test_nothing_is_said_of_force_unless_it_was_chosen():
    omni = load("omni")
    assert part_remarks(omni, tool_choice(omni))[0] == ""
    assert "left out" in part_remarks(omni, tool_choice(omni, "force"))[0]
    assert "10 mm" in part_remarks(omni, tool_choice(omni, None, 0.01))[2]
