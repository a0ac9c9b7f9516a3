"""Order of a session's trials: drawn once from a seed, stored complete before the first trial, never redrawn.

`[trials].order` is the order of conditions, or of pairs of conditions in a forced choice; with a single one the order
is random.

    counter-balanced   blocks of conditions in the order of a row of a Williams square per participant; staircases,
                       adaptive procedures and pairs are interleaved in rounds with one trial of each, and the square
                       orders the first round
    random             all trials mixed; interleaved tracks begin with a random round
    blocked            blocks of conditions, or pairs, in the order of the file
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np

from haptorb.errors import InputError
from haptorb_study.bayesian import Bayesian
from haptorb_study.procedures import FixedOrder, InterleavedProcedures, Procedure, ProcedureSequence
from haptorb_study.prompts import Prompt
from haptorb_study.staircase import Staircase
from haptorb_study.study_file import Study
from haptorb_study.trial_lists import has_set_points, is_comparison, list_pairs, list_prompts

__all__ = [
    "OrderSummary",
    "balance_conditions",
    "balance_intervals",
    "draw_runs",
    "draw_turns",
    "list_units",
    "plan",
    "plan_as_before",
    "procedure_of",
    "square_size",
    "summarize_order",
]


# --------------------------------------------------------------------------------------------------
# Counterbalancing: conditions over participants, intervals over trials, turns of interleaved tracks.


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


# --------------------------------------------------------------------------------------------------
# Order of older versions, for participants who join a study begun with one: its design does not change.
#
# Intervals were drawn trial by trial, tracks were sequential, and adaptive procedures had no practice and no
# breaks.


def plan_as_before(study: Study, participant: int) -> dict[str, Any]:
    """Plan of a session for a participant (from 0) as plain JSON types, as schema 1 to 3 stored it."""
    draw = np.random.default_rng([study.trials.seed, participant])
    names = [condition.name for condition in study.conditions]
    if study.trials.order == "counter-balanced":
        names = [names[n] for n in balance_conditions(len(names), participant)]
    parts: list[dict[str, Any]] = []
    if study.procedure in ("staircase", "bayesian"):
        for name in names:
            intervals = draw.integers(1, 3, study.levels.trials if study.levels else 0)
            parts.append({"kind": study.procedure, "condition": name, "intervals": intervals.tolist()})
    else:
        main = [prompt for name in names for prompt in _shuffle(_draw_intervals(study, name, draw), draw)]
        if study.trials.order == "random":
            main = _shuffle(main, draw)
        every = study.trials.break_every
        main = [
            replace(prompt, pause=study.trials.break_seconds) if every and n and n % every == 0 else prompt
            for n, prompt in enumerate(main)
        ]
        warm = [
            replace(main[int(n)], phase="practice", pause=0.0)
            for n in draw.integers(0, len(main), study.trials.practice)
        ]
        parts.append({"kind": "listed", "prompts": [prompt.row() for prompt in [*warm, *main]]})
    return {"participant": participant, "seed": [study.trials.seed, participant], "parts": parts}


def _draw_intervals(study: Study, name: str, draw: np.random.Generator) -> list[Prompt]:
    """The prompts in condition `name`; a forced choice was presented with its first condition."""
    return [
        replace(prompt, interval=int(draw.integers(1, 3))) if prompt.high == 2 and study.procedure != "rating"
        else prompt
        for prompt in list_prompts(study, name)
    ]  # fmt: skip


def list_units(study: Study) -> list[str]:
    """Units of the order: conditions, or "a, b" for the pairs of a forced choice."""
    if study.procedure == "forced-choice":
        return [", ".join(pair) for pair in list_pairs(study)]
    return [condition.name for condition in study.conditions]


def plan(study: Study, participant: int) -> dict[str, Any]:
    """Plan of a session for a participant (from 0) as plain JSON types; the seed combines the study's and theirs.

    participant, seed, order (the rule), units (conditions or pairs in this order), parts, and for interleaved
    parts turns (part of each trial) and pauses (number of trials answered → break before the next [s]). A study begun
    with an older haptorb keeps that version's order.
    """
    if not study.order_version:
        return plan_as_before(study, participant)
    draw = np.random.default_rng([study.trials.seed, participant])
    units = list_units(study)
    row = list(range(len(units)))
    if study.trials.order == "counter-balanced":
        row = balance_conditions(len(units), participant)
    elif study.trials.order == "random":
        row = draw.permutation(len(units)).tolist()
    about = {
        "participant": participant, "seed": [study.trials.seed, participant], "order": study.trials.order,
        "units": [units[n] for n in row],
    }  # fmt: skip
    fill = _plan_tracks if study.procedure in ("staircase", "bayesian") else _plan_list
    return {**about, **fill(study, participant, row, draw)}


def procedure_of(study: Study, stored: dict[str, Any]) -> ProcedureSequence | InterleavedProcedures:
    """The procedure at its start, from a stored plan of this or an older version."""
    parts: list[Procedure] = []
    for part in stored["parts"]:
        levels = study.levels
        if part["kind"] == "listed" or levels is None:
            parts.append(FixedOrder(tuple(Prompt.read(prompt) for prompt in part["prompts"])))
            continue
        least, most = float(levels.least or 0), float(levels.most or 0)
        intervals = tuple(part["intervals"])
        if part["kind"] == "staircase":
            start = float(levels.start or most)
            parts.append(
                Staircase(
                    levels.reference, start, least, most, levels.step, levels.reversals, intervals, part["condition"]
                )
            )
        else:
            parts.append(Bayesian(levels.reference, least, most, intervals, part["condition"]))
    if "turns" not in stored:
        return ProcedureSequence(tuple(parts))
    pauses = {int(number): float(pause) for number, pause in stored["pauses"].items()}
    return InterleavedProcedures(tuple(parts), tuple(stored["turns"]), pauses)


def _plan_tracks(study: Study, participant: int, row: Sequence[int], draw: np.random.Generator) -> dict[str, Any]:
    """Practice at the greatest difference, then one track per condition."""
    levels, trials = study.levels, study.trials
    assert levels is not None
    names = [study.conditions[n].name for n in row]
    easy = levels.reference + float(levels.most or 0)
    warm = [
        Prompt(phase="practice", condition=names[n % len(names)], level=easy, interval=interval, low=1, high=2)
        for n, interval in enumerate(draw_runs(trials.practice, draw))
    ]
    # Parts are in the order of the file for every participant.
    tracks = [
        {"kind": study.procedure, "condition": condition.name, "intervals": draw_runs(levels.trials, draw)}
        for condition in study.conditions
    ]
    lengths = [levels.trials] * len(tracks)
    if trials.order == "blocked":
        turns = [track for track, length in enumerate(lengths) for _ in range(length)]
    else:
        turns = draw_turns(lengths, row, draw)
    breaks = _list_breaks(study, len(turns))
    return {
        "parts": [{"kind": "listed", "prompts": [prompt.row() for prompt in warm]}, *tracks],
        "turns": [0] * len(warm) + [1 + track for track in turns],
        "pauses": {str(len(warm) + number): trials.break_seconds for number in breaks},
    }


def _plan_list(study: Study, participant: int, row: Sequence[int], draw: np.random.Generator) -> dict[str, Any]:
    """All trials in their order, practice first; units are balanced."""
    trials = study.trials
    if study.procedure == "forced-choice":
        listed = [prompt for condition in study.conditions for prompt in list_prompts(study, condition.name)]
        pairs = list_pairs(study)
        units = [[prompt for prompt in listed if (prompt.condition, prompt.other) == pair] for pair in pairs]
    else:
        units = [list_prompts(study, condition.name) for condition in study.conditions]
    if is_comparison(study):
        each = trials.repetitions
        chosen = [n for cell in balance_intervals(sum(map(len, units)) // each, each, participant, trials.seed)
                  for n in cell]  # fmt: skip
        numbers = iter(chosen)
        units = [[replace(prompt, interval=next(numbers)) for prompt in unit] for unit in units]
    units = [_shuffle(unit, draw) for unit in units]
    main = _arrange(study, units, row, draw)
    practice = [units[row[n % len(row)]] for n in range(trials.practice)]
    warm = [replace(unit[int(draw.integers(len(unit)))], phase="practice") for unit in practice]
    breaks = _list_breaks(study, len(main))
    main = [replace(prompt, pause=trials.break_seconds) if n in breaks else prompt for n, prompt in enumerate(main)]
    return {"parts": [{"kind": "listed", "prompts": [prompt.row() for prompt in [*warm, *main]]}]}


def _arrange(study: Study, units: list[list[Prompt]], row: Sequence[int], draw: np.random.Generator) -> list[Prompt]:
    """Arrange the trials of all units by the study's rule."""
    if study.trials.order == "random":
        return _shuffle([prompt for unit in units for prompt in unit], draw)
    if study.procedure == "forced-choice" and study.trials.order == "counter-balanced":
        rest: list[Callable[[], Prompt]] = [iter(unit).__next__ for unit in units]
        return [rest[unit]() for unit in draw_turns([len(unit) for unit in units], row, draw)]
    return [prompt for n in row for prompt in units[n]]


def _list_breaks(study: Study, trials: int) -> range:
    """Numbers of the main trials before which there is a break."""
    every = study.trials.break_every
    return range(every, trials, every) if every and study.trials.break_seconds else range(0)


def _shuffle(prompts: list[Prompt], draw: np.random.Generator) -> list[Prompt]:
    return [prompts[int(n)] for n in draw.permutation(len(prompts))]


# --------------------------------------------------------------------------------------------------
# Realised order before the first session: sequence per participant, balance, breaks.


_MAX_PRINTED_PARTICIPANTS = 1000  #: participants whose order can be printed


@dataclass(frozen=True)
class OrderSummary:
    """Order of the first participants; `plans` are their session plans as they will be stored."""

    rule: str
    units: tuple[str, ...]  #: conditions, or pairs of a forced choice
    side_by_side: bool  #: whether tracks are interleaved in rounds instead of blocks
    square: int  #: participants of a complete counterbalanced order
    plans: tuple[dict[str, Any], ...]
    sequences: tuple[tuple[str, ...], ...]  #: per participant: units of the main trials
    asked: tuple[tuple[str, ...], ...]  #: per participant: set-point, level or interval of these trials
    asks: str  #: which of these
    trials: int  #: main trials; adaptive: at most
    practice: int
    breaks: int
    break_seconds: float
    adaptive: bool  #: whether the number of trials depends on the answers

    @property
    def mixed(self) -> bool:
        """Whether trials of different units are mixed."""
        return len(self.units) > 1 and (self.side_by_side or self.rule == "random")

    @property
    def sentences(self) -> list[str]:
        """Summary for users, one sentence each."""
        most = "at most " if self.adaptive else ""
        rest = f"{self.breaks} break{'' if self.breaks == 1 else 's'} of {self.break_seconds:g} s"
        found = [
            f"{most}{self.trials} trials after {self.practice} practice trials, {most}{rest}"
            if self.breaks
            else f"{most}{self.trials} trials after {self.practice} practice trials, no breaks"
        ]
        if len(self.units) < 2:
            return [*found, "order: random, each participant's own"]
        what, unit = "first round" if self.side_by_side else "order", "pair" if ", " in self.units[0] else "condition"
        if self.rule == "counter-balanced":
            found.append(
                f"order: counter-balanced; every {self.square} participants complete a Williams square: in the {what} "
                f"every {unit} is in every position, and follows every other one, equally often"
            )
        elif self.rule == "random":
            found.append("order: random; all trials mixed" if not self.side_by_side else "order: random rounds")
        else:
            found.append(
                "order: blocked, the same for all participants: an effect of order cannot be distinguished from "
                "one of the conditions"
            )
        if self.side_by_side:
            found.append(f"rounds: each contains every {unit} once; those that have ended are skipped")
        return found

    def row(self, person: int) -> str:
        """Order of a participant as text: the first trials, per block if blocked."""
        names, asked = self.sequences[person], self.asked[person]
        if len(self.units) < 2:
            return _begin(asked, 24)
        if self.mixed:
            return _begin(names, 12)
        blocks = [[text for _, text in block] for _, block in groupby(zip(names, asked, strict=True), lambda x: x[0])]
        heads = [name for name, _ in groupby(names)]
        return "; ".join(f"{name}: {_begin(block, 6)}" for name, block in zip(heads, blocks, strict=True))

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {
            "rule": self.rule, "units": list(self.units), "side_by_side": self.side_by_side,
            "participants_for_balance": self.square, "trials": self.trials, "trials_are_a_maximum": self.adaptive,
            "practice_trials": self.practice, "breaks": self.breaks, "break_s": self.break_seconds,
            "sessions": list(self.plans),
        }  # fmt: skip


#: procedure → what varies between its trials
_VARIED = {
    "identification": "set-points", "localisation": "set-points", "constant": "levels", "magnitude": "levels",
    "staircase": "intervals with the comparison", "bayesian": "intervals with the comparison",
    "forced-choice": "intervals with the first of the pair",
}  # fmt: skip


def _label_trial(study: Study, prompt: Prompt) -> str:
    """Short label of a listed trial: set-point, level or interval."""
    if study.procedure in ("constant", "magnitude"):
        return f"{prompt.level:g}"
    return str(prompt.set_point if has_set_points(study) else prompt.interval or "–")


def _begin(texts: Sequence[str], count: int) -> str:
    return " ".join(texts[:count]) + (" ..." if len(texts) > count else "")


def summarize_order(study: Study, people: int = 6) -> OrderSummary:
    """Order for the first `people` participants, exactly as it will be stored when each begins."""
    if not 1 <= people <= _MAX_PRINTED_PARTICIPANTS:
        raise InputError(f"the order can be shown for 1 to {_MAX_PRINTED_PARTICIPANTS} participants; got {people}")
    plans = tuple(plan(study, n) for n in range(people))
    units = list_units(study)
    sequences, asked, pauses, practice = [], [], 0, 0
    for one in plans:
        procedure = procedure_of(study, one)
        names, texts, pauses, practice = [], [], 0, 0
        if isinstance(procedure, InterleavedProcedures):
            tracks = [str(part.get("condition", "")) for part in one["parts"]]
            names = [tracks[turn] for turn in procedure.turns if tracks[turn]]
            intervals = [iter(part.get("intervals", ())) for part in one["parts"]]
            texts = [str(next(intervals[turn])) for turn in procedure.turns if tracks[turn]]
            practice, pauses = len(procedure.turns) - len(names), len(procedure.pauses)
        else:
            for part in one["parts"]:
                for prompt in map(Prompt.read, part.get("prompts", ())):
                    practice += prompt.phase == "practice"
                    pauses += prompt.pause > 0
                    if prompt.phase != "practice":
                        names.append(f"{prompt.condition}, {prompt.other}" if prompt.other else prompt.condition)
                        texts.append(_label_trial(study, prompt))
                names += [str(part.get("condition", ""))] * len(part.get("intervals", ()))
                texts += map(str, part.get("intervals", ()))
        sequences.append(tuple(names))
        asked.append(tuple(texts))
    side = study.procedure in ("staircase", "bayesian", "forced-choice") and study.trials.order != "blocked"
    square = square_size(len(units)) if study.trials.order == "counter-balanced" else 1
    return OrderSummary(
        study.trials.order, tuple(units), side and bool(study.order_version), square, plans, tuple(sequences),
        tuple(asked), _VARIED.get(study.procedure, ""), len(sequences[0]), practice, pauses, study.trials.break_seconds,
        study.procedure in ("staircase", "bayesian"),
    )  # fmt: skip
