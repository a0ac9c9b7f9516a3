"""Identification: who was right where, and where wrong answers went."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from haptorb.apps.study.inference.intervals import bootstrap, wilson
from haptorb.apps.study.inference.significance import binomial_tail
from haptorb.apps.study.model.study_file import Study
from haptorb.apps.study.store.columns import Columns
from haptorb.numerics.arrays import Array

__all__ = ["Arrow", "Confusion", "count_answers", "find_arrows"]

WANDERED = 1 / 3  #: an arrow is drawn where this share of the wrong answers, or more, went to one set-point


@dataclass(frozen=True)
class Confusion:
    """Answers (columns) to prompts (rows), averaged over participants; all arrays by set-point in the study's order."""

    numbers: tuple[int, ...]
    counts: Array  #: (n, n) answers, pooled
    matrix: Array  #: (n, n) share of answers, averaged over participants
    low: Array  #: (n, n)
    high: Array  #: (n, n)
    accuracy: float  #: averaged over participants
    accuracy_95: tuple[float, float]  #: over people
    pooled_95: tuple[float, float]  #: Wilson's, as if all trials were alike
    chance: float
    p_chance: float  #: of so many right answers by guessing


@dataclass(frozen=True)
class Arrow:
    """A third or more of the wrong answers to `of` went to `to`."""

    of: int
    to: int
    wrong: int  #: wrong answers to `of`
    share: float


def count_answers(study: Study, main: Columns, index: np.ndarray[Any, Any], people: int) -> Confusion:
    numbers = tuple(point.number for point in study.points)
    place = {number: n for n, number in enumerate(numbers)}
    asked = np.array([place[int(n)] for n in main["set_point"]])
    answered = np.array([place[int(n)] for n in main["answer"]])
    each = np.zeros((people, len(numbers), len(numbers)))
    np.add.at(each, (index, asked, answered), 1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        shares = each / each.sum(axis=2, keepdims=True)
    finite = np.isfinite(shares)
    matrix = np.where(finite, shares, 0).sum(axis=0) / np.maximum(finite.sum(axis=0), 1)
    matrix[~finite.any(axis=0)] = np.nan
    low, high = bootstrap(shares)
    right = asked == answered
    own = np.bincount(index, right, people) / np.bincount(index, minlength=people)
    a, b = bootstrap(own)
    k, n = int(right.sum()), len(right)
    chance = 1 / len(numbers)
    return Confusion(
        numbers, each.sum(axis=0), matrix, low, high, float(own.mean()), (float(a), float(b)), wilson(k, n), chance,
        binomial_tail(k, n, chance),
    )  # fmt: skip


def find_arrows(confusion: Confusion) -> tuple[Arrow, ...]:
    wrong = confusion.counts - np.diag(np.diag(confusion.counts))
    found = []
    for i, row in enumerate(wrong):
        total = row.sum()
        for j in np.flatnonzero(row):
            if row[j] / total >= WANDERED - 1e-12:
                of, to = confusion.numbers[i], confusion.numbers[int(j)]
                found.append(Arrow(of, to, int(total), float(row[j] / total)))
    return tuple(found)
