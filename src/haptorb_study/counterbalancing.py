"""Counterbalancing: conditions over participants, intervals over trials, turns of interleaved tracks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["balance_conditions", "balance_intervals", "draw_runs", "draw_turns", "square_size"]


_BALANCED_BLOCK_TRIALS = 6  #: block of trials of a track within which both intervals are equally frequent


def balance_conditions(conditions: int, participant: int) -> list[int]:
    """Order of `conditions` for a participant (from 0): Williams square, balanced for first-order carry-over.

    >>> [balance_conditions(4, n) for n in range(4)]
    [[0, 1, 3, 2], [1, 2, 0, 3], [2, 3, 1, 0], [3, 0, 2, 1]]
    """
    first = [0]
    low, high = 1, conditions - 1
    while low <= high:
        first.append(low)
        if low < high:
            first.append(high)
        low, high = low + 1, high - 1
    row = [(n + participant) % conditions for n in first]
    # With an odd number each row is needed forwards and backwards.
    return row[::-1] if conditions % 2 and (participant // conditions) % 2 else row


def square_size(conditions: int) -> int:
    """Number of participants of a complete `balance_conditions` square.

    >>> [square_size(n) for n in (1, 2, 3, 4, 5)]
    [1, 2, 6, 4, 10]
    """
    return 1 if conditions < 2 else conditions if conditions % 2 == 0 else 2 * conditions


def balance_intervals(cells: int, each: int, participant: int, seed: int) -> list[list[int]]:
    """For each of `cells` (level in a condition, pair of conditions) `each` intervals, 1 or 2, in random order.

    Both are equally frequent in a cell. If `each` is odd, the more frequent interval is balanced over the cells of a
    participant, and for every cell over the participants 2k and 2k + 1.

    >>> sorted(balance_intervals(1, 4, 0, 0)[0])
    [1, 1, 2, 2]
    """
    pair = np.random.default_rng([seed, participant // 2, 1]).permutation(cells)
    draw = np.random.default_rng([seed, participant, 2])
    found = []
    for cell in range(cells):
        more = 1 + (int(pair[cell]) + participant) % 2
        both = [1, 2] * (each // 2) + [more] * (each % 2)
        found.append([both[int(n)] for n in draw.permutation(each)])
    return found


def draw_runs(length: int, draw: np.random.Generator) -> list[int]:
    """(length) intervals, 1 or 2, of a track that may end at any trial: three of each in every block of six.

    >>> sum(draw_runs(12, np.random.default_rng(1)))
    18
    """
    found: list[int] = []
    while len(found) < length:
        found += (1 + draw.permutation(_BALANCED_BLOCK_TRIALS) % 2).tolist()
    return found[:length]


def draw_turns(lengths: Sequence[int], first: Sequence[int], draw: np.random.Generator) -> list[int]:
    """Which track is next, trial by trial: each round has every track once, in random order, `first` in the first.

    While all tracks are running, none has more than two trials running and none is more than one trial ahead.

    >>> draw_turns([1, 1], [1, 0], np.random.default_rng(0))
    [1, 0]
    """
    turns: list[int] = []
    for number in range(max(lengths, default=0)):
        order = list(first) if number == 0 else draw.permutation(len(lengths)).tolist()
        turns += [track for track in order if number < lengths[track]]
    return turns
