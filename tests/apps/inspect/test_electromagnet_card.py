"""The card of the Omni: what is calibrated stands beside what the coils' sizes predict."""

import io

import numpy as np
import pytest
from rich.console import Console

from haptorb.apps.inspect.card import card
from haptorb.devices.loader import load

OMNI = load("omni")


@pytest.fixture(scope="module")
def made():
    return card(OMNI)


def test_calibrated_and_predicted_moments_are_told(made):
    numbers = made.numbers()
    assert numbers["moment_per_current_m2"] == OMNI.moment_per_current.tolist()
    assert np.array(numbers["predicted_moment_per_current_m2"]) == pytest.approx(OMNI.predict_moments())


def test_people_see_both_and_the_difference(made):
    out = io.StringIO()
    made.show(Console(file=out, width=100))
    told = out.getvalue()
    predicted = np.diag(OMNI.predict_moments())
    for k in range(3):
        assert f"{predicted[k]:+.4f}" in told
        assert f"{100 * (predicted[k] / OMNI.moment_per_current[k, k] - 1):+.1f}" in told
