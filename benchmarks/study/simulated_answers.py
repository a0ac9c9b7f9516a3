"""Answers of people with known psychometric function, accuracy and errors; drawn without the fits under test."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from haptorb_study.columns import Columns
from haptorb_study.order import plan, procedure_of
from haptorb_study.prompts import Answer, Prompt
from haptorb_study.statistics.psychometric_function import LevelCounts
from haptorb_study.study_file import Study, study_of

LEVELS = np.linspace(0.6, 1.4, 9)
SPREAD, REPETITIONS = 0.12, 20
NOTICED = 0.6745 * SPREAD  #: from 50 to 75 %
ACCURACY, TRIALS = 0.72, 50
ERROR, ERRORS, ERROR_CV = 6.0, 16, 0.75
_STUDIES: dict[str, Study] = {}


@dataclass(frozen=True)
class Truth:
    """Everybody's own function."""

    middles: np.ndarray[Any, Any]
    spreads: np.ndarray[Any, Any]
    lapses: np.ndarray[Any, Any]

    def shares(self, levels: Any) -> np.ndarray[Any, Any]:
        """(people, levels) probability of the answer that the comparison was the stronger."""
        z = (np.asarray(levels) - self.middles[:, None]) / self.spreads[:, None]
        found: np.ndarray[Any, Any] = self.lapses[:, None] + (1 - 2 * self.lapses[:, None]) * ndtr(z)
        return found


def draw_people(draw: np.random.Generator, people: int, sd: float) -> Truth:
    """Points of equality about 1, log spreads about log 0.12, with the same standard deviation."""
    middles = LEVELS.mean() + sd * draw.standard_normal(people)
    return Truth(middles, SPREAD * np.exp(sd * draw.standard_normal(people)), draw.beta(2, 98, people))


def draw_constant(draw: np.random.Generator, people: int, sd: float) -> tuple[LevelCounts, Truth]:
    """Counted answers to constant stimuli."""
    truth = draw_people(draw, people, sd)
    of = np.full((people, len(LEVELS)), float(REPETITIONS))
    return LevelCounts(LEVELS, draw.binomial(REPETITIONS, truth.shares(LEVELS)).astype(float), of), truth


def draw_misfit(draw: np.random.Generator, people: int, sd: float) -> LevelCounts:
    """Answers that no fit assumes: logistic functions, people who differ skewedly, lapses of a few, unequal trials.

    Points of equality and the distance from there to 75 % have the means of `draw_people`, and exponential deviations.
    """
    middles = LEVELS.mean() + sd * (draw.exponential(1.0, people) - 1)
    noticed = NOTICED * np.exp(sd * (draw.exponential(1.0, people) - 1))
    lapses = np.where(draw.random(people) < 0.3, 0.05, 0.005)[:, None]
    of = np.repeat(draw.integers(8, 31, people)[:, None], len(LEVELS), axis=1)
    z = (LEVELS - middles[:, None]) / noticed[:, None] * np.log(3.0)
    share = lapses + (1 - 2 * lapses) / (1 + np.exp(-z))
    return LevelCounts(LEVELS, draw.binomial(of, share).astype(float), of.astype(float))


def draw_accuracies(draw: np.random.Generator, people: int, sd: float, mean: float = ACCURACY) -> np.ndarray[Any, Any]:
    """(people,) of a Beta distribution."""
    if sd == 0:
        return np.full(people, mean)
    size = mean * (1 - mean) / sd**2 - 1
    return draw.beta(mean * size, (1 - mean) * size, people)


def draw_shares(
    draw: np.random.Generator, people: int, sd: float, mean: float = ACCURACY, trials: int = TRIALS
) -> tuple[Any, Any]:
    """(people,) right answers, of (people,)."""
    return draw.binomial(trials, draw_accuracies(draw, people, sd, mean)), np.full(people, trials)


def draw_logistic_shares(
    draw: np.random.Generator, people: int, sd: float, mean: float = ACCURACY, trials: int = TRIALS
) -> tuple[Any, Any]:
    """As `draw_shares`, of people whose shares have normal logits: the same mean and standard deviation."""
    centre, spread = _find_logits(mean, sd)
    shares = 1 / (1 + np.exp(-centre - spread * draw.standard_normal(people)))
    return draw.binomial(trials, shares), np.full(people, trials)


@cache
def _find_logits(mean: float, sd: float) -> tuple[float, float]:
    """Mean and standard deviation of normal logits whose shares have these."""
    if sd == 0:
        return float(np.log(mean / (1 - mean))), 0.0
    x, weight = np.polynomial.hermite_e.hermegauss(181)
    weight /= weight.sum()

    def moments(centre: float, spread: float) -> tuple[float, float]:
        share = 1 / (1 + np.exp(-np.clip(centre + spread * x, -700, 700)))
        first = float(weight @ share)
        return first, float(np.sqrt(max(weight @ share**2 - first**2, 0.0)))

    def find_centre(spread: float) -> float:
        return float(brentq(lambda centre: moments(centre, spread)[0] - mean, -50, 50))

    spread = float(brentq(lambda one: moments(find_centre(one), one)[1] - sd, 1e-3, 8.0))
    return find_centre(spread), spread


def draw_errors(draw: np.random.Generator, people: int, sd: float, trials: int = ERRORS) -> np.ndarray[Any, Any]:
    """(people, trials) [mm]."""
    shape = 1 / ERROR_CV**2
    means = ERROR * np.maximum(1 + sd * draw.standard_normal(people), 0.05)
    return means[:, None] * draw.gamma(shape, 1 / shape, (people, trials))


def draw_stored(draw: np.random.Generator, people: int, sd: float) -> tuple[Study, Columns]:
    """A whole study with constant stimuli: every prompt of everybody's plan, answered one by one."""
    study = _study("constant", f"[trials]\nrepetitions = {REPETITIONS}\n[levels]\nreference = 1.0\n"
                   f"values = {[round(float(x), 6) for x in LEVELS]}\n")  # fmt: skip
    truth = draw_people(draw, people, sd)
    rows = []
    for n in range(people):
        for prompt in _prompts(study, n):
            share = float(truth.shares([prompt.level])[n, 0])
            rows.append((n, prompt, prompt.interval if draw.random() < share else 3 - prompt.interval, np.nan))
    return study, _columns(study, rows)


def answer_identification(draw: np.random.Generator, people: int, sd: float) -> tuple[Study, Columns]:
    """A whole identification: 25 set-points twice, wrong answers anywhere else, errors at 36 deg as stated."""
    study = _study("identification", "[trials]\nrepetitions = 2\n")
    shares, errors = draw_accuracies(draw, people, sd), draw_errors(draw, people, sd, TRIALS)
    rows = []
    for n in range(people):
        for trial, prompt in enumerate(_prompts(study, n)):
            right = draw.random() < shares[n]
            other = 1 + (prompt.set_point - 1 + int(draw.integers(1, 25))) % 25
            rows.append((n, prompt, prompt.set_point if right else other, errors[n, trial]))
    return study, _columns(study, rows)


def answer_track(
    draw: np.random.Generator, procedure: str, people: int, sd: float
) -> tuple[Study, Columns, list[float], float]:
    """A staircase or QUEST+: study, answers, everybody's threshold, and the mean of log2 over the population.

    Observers: p(right) = ½ + (½ − λ) Φ(s log₂(difference / x)), s = 1.5 on average, x = 0.12 on average.
    """
    trials = 60 if procedure == "staircase" else 40
    study = _study(procedure, f"[levels]\nreference = 1.0\nleast = 0.01\nmost = 0.8\nstart = 0.6\nreversals = 100\n"
                   f"trials = {trials}\n")  # fmt: skip
    places, slopes = np.log2(0.12) + sd * draw.standard_normal(people), 1.5 * np.exp(0.2 * draw.standard_normal(people))
    rows = []
    for n in range(people):
        procedure_now = procedure_of(study, plan(study, n))
        while (prompt := procedure_now.prompt) is not None:
            p = 0.5 + 0.48 * ndtr(slopes[n] * (np.log2(prompt.level - 1.0) - places[n]))
            answer = prompt.interval if draw.random() < p else 3 - prompt.interval
            rows.append((n, prompt, answer, np.nan))
            procedure_now = procedure_now.record_answer(Answer(answer))
    # Of a staircase the threshold is where 70.7 % are right: below the middle by as much as the slope tells.
    away = -0.1726 if procedure == "staircase" else 0.0
    own = 2 ** (places + away / slopes)
    mean = float(np.log2(0.12) + away * np.exp(0.2**2 / 2) / 1.5)
    return study, _columns(study, rows), own.tolist(), mean


def _study(procedure: str, rest: str) -> Study:
    if procedure not in _STUDIES:
        _STUDIES[procedure] = study_of(f'name = "simulated"\nprocedure = "{procedure}"\n{rest}')
    return _STUDIES[procedure]


def _prompts(study: Study, participant: int) -> list[Prompt]:
    """All that one person is asked; nothing in it depends on the answers."""
    stored = plan(study, participant)
    return [Prompt.read(prompt) for part in stored["parts"] for prompt in part["prompts"]]


def _columns(study: Study, rows: list[tuple[int, Prompt, int, float]]) -> Columns:
    """As the database's answers come."""
    people, prompts, answers, errors = zip(*rows, strict=True)
    number = np.array([prompt.set_point for prompt in prompts])
    theta = np.array([study.point(n).theta_deg if n else np.nan for n in number.tolist()])
    count = len(rows)
    answered = np.array(answers)
    return {
        "participant": np.array([f"SIM{n + 1:02d}" for n in people]), "simulated": np.full(count, True),
        "simulated_device": np.full(count, True, dtype=object), "trial": np.arange(count),
        **{name: np.array([getattr(prompt, name) for prompt in prompts])
           for name in ("phase", "condition", "other", "level", "interval")},
        "set_point": number, "theta_deg": theta, "answer": answered, "distance_mm": np.array(errors),
        "session": np.array(people), "phi_deg": np.full(count, np.nan), "angle_deg": np.full(count, np.nan),
        **{name: np.full(count, np.nan) for name in ("x_m", "y_m", "z_m")},
        "recording": np.full(count, ""), "answered": np.full(count, ""),
        "correct": (answered == number).astype(float), "safety": np.full(count, ""),
        "repeats": np.zeros(count, dtype=int), "seconds": np.ones(count),
    }  # fmt: skip
