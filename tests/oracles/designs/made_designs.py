"""Synthetic results of a design: an Omni whose numbers are simple functions of its parameters."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from haptorb_design.problem import (
    Bound,
    Design,
    DesignGoal,
    DesignParameter,
    DesignQuantity,
    Evaluation,
    ParameterPlace,
)
from haptorb_design.store import open_results


@cache
def make_design(goals: int = 2) -> Design:
    """With so many objectives, at most two: the pull is to be small, the force great."""

    def quantity(name: str, unit: str, sense: str) -> DesignQuantity:
        return DesignQuantity(name, unit, sense, "made up", ("spherical-electromagnet",), lambda candidate: np.nan)

    pull, force = quantity("core_pull", "N", "minimise"), quantity("continuous_force", "N", "maximise")
    parameters = (
        DesignParameter("core_radius", (ParameterPlace("electromagnet.core_radius"),), "mm", 11.0, 16.0),
        DesignParameter("tool_length", (ParameterPlace("tool.length"),), "mm", 16.0, 30.0),
        DesignParameter("friction", (ParameterPlace("dome.friction"),), "", 0.05, 0.3),
        DesignParameter(
            "rate", (ParameterPlace("supply.voltage"),), choices=(("<low>", "12 V"), ("high & dear", "24 V"))
        ),
    )
    made = (DesignGoal(pull, "minimise", "core_pull"), DesignGoal(force, "maximise", "continuous_force"))
    bounds = (Bound("mass", quantity("mass", "kg", "minimise"), high=0.028),)
    # No quantity is defined for the base device, as a process that computes them would find in some seconds.
    return Design(
        "omni-core", "Omni: <core> & tool", "omni", parameters, made[:goals], bounds, {}, "name = 'omni'\n", "0" * 64,
        base_values={},
    )  # fmt: skip


def make_evaluations(count: int, seed: int = 1) -> list[Evaluation]:
    """Designs drawn evenly; about a fifth is refused."""
    generator = np.random.default_rng(seed)
    low, high = np.array([11.0, 16.0, 0.05, 0.0]), np.array([16.0, 30.0, 0.3, 2.0])
    found = []
    for number, place in enumerate(generator.uniform(low, high, (count, 4)).tolist()):
        core, length, friction, choice = place
        values = {"core_radius": core, "tool_length": length, "friction": friction,
                  "rate": ("<low>", "high & dear")[int(choice)]}  # fmt: skip
        mass = 0.001 * length
        if core < 12.0 and length < 24.0:
            found.append(Evaluation(number, values, {}, {}, "device", "the <coils> overlap by 0.3 mm", 0.01))
        elif mass > 0.028:
            found.append(
                Evaluation(number, values, {}, {"mass": mass}, "mass", f"{mass:.3g} kg is above 0.028 kg", 0.01)
            )
        else:
            pull = 0.05 * (core / 15.0) ** 5 * (length / 24.0) * (1 + (friction - 0.15) ** 2)
            force = 0.2 * (core / 15.0) ** 1.5 * (length / 24.0) ** 0.5 * (1.0 if choice < 1.0 else 1.2)
            force /= 1 + 30 * (friction - 0.17) ** 2
            found.append(Evaluation(number, values, {"core_pull": pull, "continuous_force": force}, {"mass": mass}))
    return found


def make_results(path: Path, count: int = 300, goals: int = 2, method: str = "sobol") -> Path:
    """A results file with one run of so many designs."""
    with open_results(path, make_design(goals), method, 1) as writer:
        writer.add(make_evaluations(count))
    return path
