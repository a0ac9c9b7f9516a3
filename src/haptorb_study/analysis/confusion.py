"""Confusion matrix of an identification, and the most frequent confusions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from haptorb.arrays import Array
from haptorb_study.analysis.number_format import format_range
from haptorb_study.columns import Columns
from haptorb_study.statistics.intervals import share_interval, wilson
from haptorb_study.statistics.significance import binomial_tail
from haptorb_study.study_file import Study

__all__ = ["Arrow", "Confusion", "count_answers", "describe_accuracy", "find_arrows", "list_wrong_answers"]


MIN_ARROW_SHARE = 1 / 3  #: share of the wrong answers to a set-point that must agree for an arrow


@dataclass(frozen=True)
class Confusion:
    """Confusion matrix: prompts (rows) × answers (columns), averaged over participants, in the study's order."""

    numbers: tuple[int, ...]
    counts: Array  #: (n, n) answers of all participants
    matrix: Array  #: (n, n) share of answers, averaged over participants
    right_95: Array  #: (n, 2) confidence limits of the share of correct answers to each set-point
    accuracy: float  #: averaged over participants
    accuracy_95: tuple[float, float]  #: confidence limits over participants; NaN with one participant
    single_95: tuple[float, float]  #: with one participant only: Wilson's interval over the trials; else NaN
    chance: float
    p_chance: float  #: probability of at least as many correct answers by guessing


@dataclass(frozen=True)
class Arrow:
    """Confusion of set-point `of` with set-point `to` in at least a third of the wrong answers to `of`."""

    of: int
    to: int
    wrong: int  #: wrong answers to `of`
    share: float


def count_answers(study: Study, main: Columns, index: np.ndarray[Any, Any], people: int) -> Confusion:
    """Count answers by prompt; `index` (trials,) is the participant of each trial, of `people` participants."""
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
    right = asked == answered
    shown, named = each.sum(axis=2), np.einsum("pii->pi", each)
    limits = np.array([share_interval(named[:, n], shown[:, n]) for n in range(len(numbers))])
    total, good = np.bincount(index, minlength=people), np.bincount(index, right, people)
    k, n = int(right.sum()), len(right)
    chance = 1 / len(numbers)
    single = wilson(k, n) if people == 1 else (math.nan, math.nan)
    return Confusion(
        numbers, each.sum(axis=0), matrix, limits, float((good / total).mean()), share_interval(good, total), single,
        chance, binomial_tail(k, n, chance),
    )  # fmt: skip


def find_arrows(confusion: Confusion) -> tuple[Arrow, ...]:
    """Confusions that make up at least a third of the wrong answers to a set-point."""
    wrong = confusion.counts - np.diag(np.diag(confusion.counts))
    found = []
    for i, row in enumerate(wrong):
        total = row.sum()
        for j in np.flatnonzero(row):
            if row[j] / total >= MIN_ARROW_SHARE - 1e-12:
                of, to = confusion.numbers[i], confusion.numbers[int(j)]
                found.append(Arrow(of, to, int(total), float(row[j] / total)))
    return tuple(found)


def list_wrong_answers(arrows: Sequence[Arrow], number: int) -> str:
    """Most frequent wrong answers to set-point `number`, with their counts, as text."""
    return ", ".join(f"{one.to} ({round(one.share * one.wrong)} of {one.wrong})" for one in arrows if one.of == number)


def describe_accuracy(confusion: Confusion) -> str:
    """Confidence interval of the accuracy as text, and what it is taken over."""
    over_people = format_range(confusion.accuracy_95, ".1f", 100)
    if over_people != "–":
        return f"95 % over participants {over_people} %"
    single = format_range(confusion.single_95, ".1f", 100)
    return f"one participant: Wilson over this participant's trials {single} %; no interval over participants"
