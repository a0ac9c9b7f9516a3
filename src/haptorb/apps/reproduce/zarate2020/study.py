"""Zárate 2020, section IV, Figs. 8 and 9: the study's design, and what only people could answer."""

from __future__ import annotations

from collections import Counter

import numpy as np

from haptorb.apps.reproduce.citation import Citation
from haptorb.apps.reproduce.item import Item
from haptorb.apps.reproduce.registry import Drawing, Report
from haptorb.apps.reproduce.zarate2020.simulated_study import draw_study
from haptorb.apps.study.model.order import plan
from haptorb.apps.study.model.set_points import directions, list_published
from haptorb.apps.study.model.study_file import study_of

__all__ = ["items"]

_AT = Citation("zarate2020", "study", "§IV")
_PEOPLE = "answers of people; `haptorb study run` runs the same procedure and computes the same figures"


def items(report: Report) -> tuple[tuple[Item, ...], Drawing]:
    """Set-points, order and counts of the study as the kit runs it."""
    points = list_published()
    u = directions(points)
    apart = np.degrees(np.arccos(np.clip(u @ u.T, -1, 1))) + 360 * np.eye(len(points))
    rings = sorted({point.theta_deg for point in points})
    study = study_of('name = "published"')
    plans = [plan(study, person) for person in range(6)]
    prompts = [[prompt for part in one["parts"] for prompt in part["prompts"] if prompt.get("phase") != "practice"]
               for one in plans]  # fmt: skip
    numbers = [[prompt["set_point"] for prompt in one] for one in prompts]
    report(0.7)
    world = study.make_world(study.conditions[0].name, points[0].number)
    found = (
        _AT.item("points", "set-points", 25, len(points)),
        _AT.item("rings", "angles θ with an error of their own in Fig. 9", 4, len(rings), where="Fig. 9"),
        _AT.item("meridian", "set-points apart along a meridian", 18.0, np.diff(rings).mean(), "°", 1e-9, where="§I"),
        _AT.item("nearest", "nearest set-points apart: 'evenly separated by 18°'", 18.0, apart.min(), "°", 1e-9),
        _AT.item("twice", "how often a person is asked for each point: 'exactly twice'", 2,
                 np.mean([set(Counter(one).values()) == {2} for one in numbers]) * 2, "1", 1e-9),
        _AT.item("per-person", "data points per user", 50, len(numbers[0])),
        _AT.item("total", "data points of six users", 300, sum(map(len, numbers))),
        _AT.claim("random", "share of the users whose order differs from all others'", 1.0,
                 len({tuple(one) for one in numbers}) / len(numbers), "1", 0.0, "'randomly selected'"),
        _AT.item("theta-1", "θ₁ of the rendered map: 'same mapping parameters as in Fig. 2'", 18.0,
                 getattr(world, "half_width_deg", float("nan")), "°", 1e-9),
        _AT.item("theta-2", "θ₂ of it", 54.0, getattr(world, "cut_off_deg", float("nan")), "°", 1e-9),
        _AT.claim("repulsive", "sign of its moment: 'only repulsive forces'", 1.0,
                 np.sign(getattr(world, "moment", float("nan"))), "1", 0.0, "a direction"),
        _AT.exempt("confusion", "confusion matrix of 25 set-points, answers drawn to the neighbour higher up",
                      _PEOPLE, "Fig. 8"),
        *(
            _AT.exempt(f"error-{theta}", f"error at θ = {theta}°: {text} mm", _PEOPLE, "Fig. 9")
            for theta, text in ((0, "2.5 ± 1.4"), (18, "5.7 ± 4.6"), (36, "6.5 ± 5.2"), (54, "7.2 ± 5.1"))
        ),
        _AT.exempt("grows", "error grows with θ, gravity as a reason", _PEOPLE, "Fig. 9"),
        _AT.exempt("arrows", "arrows where a third of the wrong answers went to one point", _PEOPLE, "Fig. 8"),
        _AT.exempt("discern", "'users can discern at least 25 locations'", _PEOPLE, "Abstract"),
    )  # fmt: skip
    report(1.0)
    return found, draw_study
