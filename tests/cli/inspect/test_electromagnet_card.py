"""Card of the Omni: calibrated moments beside those predicted from the coils' sizes."""

import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from haptorb.cli.cards import card
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


def text_of(device):
    out = io.StringIO()
    card(device).show(Console(file=out, width=400))
    return out.getvalue()


def test_moments_that_differ_have_a_line_of_their_own():
    windings = replace(OMNI.windings, turns=2 * OMNI.windings.turns)
    device = replace(OMNI, windings=windings)
    lines = [line for line in text_of(device).splitlines() if line.startswith("Moments differ")]
    assert len(lines) == 1
    for k, percent in enumerate(("+79 %", "+81 %", "+81 %")):
        assert f"{np.linalg.norm(OMNI.moment_per_current[:, k]):.4f} m²" in lines[0]
        assert f"{2 * OMNI.predict_moments()[k, k]:.4f} m²" in lines[0]
        assert percent in lines[0]
    assert any("moments differ" in remark for remark in card(device).numbers()["remarks"])
    fingertip = load("omni-fingertip")
    assert not any("differ" in remark for remark in fingertip.remarks)


def test_a_card_says_that_moments_come_from_the_windings_and_how_good_that_is():
    device = replace(OMNI, moment_per_current=OMNI.predict_moments(), moments_from="windings")
    told = text_of(device)
    assert "computed from [windings]" in told
    assert "off by" not in told


def test_continuous_force_is_stated_with_one_coil_warm_and_with_all(made):
    """The factor between both is that of the currents; a device whose coils are not coupled has one figure only."""
    contact = made.numbers()["layers"][0]
    one, all_warm = contact["continuous_radial_n"], contact["continuous_radial_all_warm_n"]
    assert all_warm / one == pytest.approx(OMNI.sustained_current_together[0] / OMNI.sustained_current[0])
    text = text_of(OMNI)
    assert f"{1e3 * one:.0f}" in text
    assert f"{1e3 * all_warm:.0f}" in text
    assert "4.75 A continuous with one coil warm, 3.27 A with all coils warm" in text
    alone = replace(OMNI, coils=replace(OMNI.coils, heat=replace(OMNI.coils.heat, coupling=None)))
    assert "all coils warm" not in text_of(alone)


def test_peaks_are_what_the_supply_gives(made):
    """A quarter of the power halves the peak where only the supply limits it; what lasts stays."""
    weak = card(replace(OMNI, supply=replace(OMNI.supply, power=40.0))).numbers()
    weaker = card(replace(OMNI, supply=replace(OMNI.supply, power=10.0))).numbers()
    assert weaker["layers"][0]["peak_radial_n"] == pytest.approx(weak["layers"][0]["peak_radial_n"] / 2)
    assert weak["feasible"][0]["guaranteed_force_n"] < made.numbers()["feasible"][0]["guaranteed_force_n"]
    assert weak["supply_w"] == 40.0
