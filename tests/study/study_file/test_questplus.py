"""Adaptive procedure against a QUEST+ library (questplus): the same choices, trial by trial."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb_study.bayesian import Bayesian
from haptorb_study.prompts import Answer


def test_it_asks_what_the_library_asks() -> None:
    oracle = pytest.importorskip("questplus", reason="questplus is not installed")
    own = Bayesian(1.0, 0.01, 1.0, (1,) * 25)
    slopes = np.geomspace(0.5, 6.0, 12)
    # The library's cumulative normal over log10 of the intensity: its spread is 1/s octaves, in log10 units.
    library = oracle.QuestPlus(
        stim_domain={"intensity": np.log10(own.differences)},
        param_domain={
            "mean": np.log10(own.thresholds), "sd": np.log10(2) / slopes, "lower_asymptote": [0.5],
            "lapse_rate": [own.lapse],
        },
        outcome_domain={"response": ["right", "wrong"]},
        func="norm_cdf", stim_scale="linear", stim_selection_method="min_entropy",
    )  # fmt: skip
    draw = np.random.default_rng(5)
    for _ in range(25):
        prompt = own.prompt
        assert prompt is not None
        asked = prompt.level - 1.0
        wanted = library.next_stim
        assert asked == pytest.approx(10 ** wanted["intensity"], rel=1e-9)
        right = bool(draw.random() < (0.95 if asked > 0.15 else 0.55))
        own = own.advance(Answer(1 if right else 2))
        library.update(stim=wanted, outcome={"response": "right" if right else "wrong"})
    known = library.marginal_posterior["mean"]
    assert own.posterior.sum(axis=1) == pytest.approx(np.asarray(known), abs=1e-9)
