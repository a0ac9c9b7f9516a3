"""Optimiser of the free parameters of a design, one generation at a time, with pymoo.

Several objectives: NSGA-II (Deb et al. 2002). One objective: differential evolution (Storn and Price 1997): a child
takes nine tenths of its parameters from the best so far plus 0.7 of the difference of two others, and one in ten is
changed besides. Duplicates of earlier candidates are also changed until they are new: near the end most are duplicates,
and small generations would leave workers idle and take long to replay. A valid candidate replaces a rejected one, and
of two rejected ones the one nearer to being valid stays (Deb 2000). NSGA-II with one objective stops short of the best
if several constraints are active. Where no parameter is a continuous range, differences lead to what was tried before,
and NSGA-II serves for one objective too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from pymoo.core.duplicate import DuplicateElimination
from pymoo.core.repair import Repair
from pymoo.operators.crossover.sbx import SBX
from pymoo.operators.mutation.pm import PM

from haptorb.errors import InputError
from haptorb_design.problem import Design, Evaluation, Value
from haptorb_design.search_space import SearchSpace, measure_violation
from haptorb_design.store import check_values

__all__ = ["POPULATION", "MixedCrossover", "MixedMutation", "NewOnly", "Optimiser", "Snap", "optimise"]


# --------------------------------------------------------------------------------------------------
# Genetic operators of pymoo for parameters with steps and unordered choices. Those for real numbers rarely leave a step
# or a choice, since their changes are smaller.


Array = NDArray[np.float64]


@final
class MixedCrossover(SBX):  # type: ignore[misc]
    """Simulated binary crossover of ranges and steps (Deb & Agrawal 1995); choices are inherited from either parent."""

    def __init__(self, space: SearchSpace) -> None:
        super().__init__(eta=15, prob=0.9)
        self._space = space

    def _do(self, problem: Any, X: Array, *args: Any, random_state: Any = None, **options: Any) -> Array:
        children: Array = super()._do(problem, X, *args, random_state=random_state, **options)
        swap = random_state.random(X.shape[1:]) < 0.5
        choices = np.where(swap, X[::-1], X)
        return np.where(self._space.free, choices, children)


@final
class MixedMutation(PM):  # type: ignore[misc]
    """Polynomial mutation of ranges (Deb & Goyal 1996); a step or a few up or down; any other choice.

    Each parameter of a child that is changed does so with probability 1 / (number of parameters).

    prob  probability that a child is changed
    """

    def __init__(self, space: SearchSpace, prob: float = 1.0) -> None:
        super().__init__(eta=20, prob=prob)
        self._space = space

    def _do(self, problem: Any, X: Array, *args: Any, random_state: Any = None, **options: Any) -> Array:
        space = self._space
        ranges: Array = super()._do(problem, X, *args, random_state=random_state, **options)
        levels = np.maximum(space.levels, 1)
        hit = random_state.random(X.shape) < 1.0 / X.shape[1]
        draw = random_state.random(X.shape)
        up = np.where(random_state.random(X.shape) < 0.5, 1.0, -1.0)
        steps = X + up * np.ceil(-np.log2(1.0 - draw) + 1e-12) / np.maximum(
            levels - 1, 1
        )  # 1, 2, 3 …: half as often each
        choices = np.mod(X + (1.0 + np.floor(draw * np.maximum(levels - 1, 1))) / levels, 1.0)
        moved = np.where(space.free, choices, steps)
        return np.where(space.levels > 0, np.where(hit, moved, X), ranges)


@final
class Snap(Repair):  # type: ignore[misc]
    """Rounds candidates to the steps and choices."""

    def __init__(self, space: SearchSpace) -> None:
        super().__init__()
        self._space = space

    def _do(self, problem: Any, X: Array, **options: Any) -> Array:
        return self._space.snap(X)


@final
class NewOnly(DuplicateElimination):  # type: ignore[misc]
    """Removes candidates that the run had before.

    old  bytes of the points of the run so far; extended by the optimiser
    """

    def __init__(self) -> None:
        super().__init__()
        self.old: set[bytes] = set()

    def find_old(self, pop: Any) -> NDArray[np.bool_]:
        """Mask of the candidates in `pop` (n,) that the run had before, or that are duplicates."""
        return self._do(pop, None, np.zeros(len(pop), dtype=bool))

    def _do(self, pop: Any, other: Any, is_duplicate: NDArray[np.bool_]) -> NDArray[np.bool_]:
        there = set() if other is None else {point.tobytes() for point in other.get("X")}
        for index, point in enumerate(pop.get("X")):
            key = point.tobytes()
            is_duplicate[index] = key in there or key in self.old
            if other is None:
                there.add(key)
        return is_duplicate


# --------------------------------------------------------------------------------------------------
# Optimiser: proposes a generation of candidates, receives their evaluations.


POPULATION = 50  #: default number of candidates of a generation
_MAX_IDLE_GENERATIONS = 100  #: generations of differential evolution without a new candidate before it ends
_MAX_MUTATIONS = 10  #: attempts to change a duplicate child of differential evolution before it is left out


@final
class Optimiser:
    """Ask-tell optimiser: proposes a generation of candidates, receives their evaluations.

    The same design, seed and population give the same candidates under the same numbers, however and in whichever
    order they were computed. The first generation is a Latin hypercube. No candidate is proposed twice.

    Raises InputError for a design without a parameter or an objective, or a population below 4.
    """

    def __init__(self, design: Design, *, seed: int, population: int = POPULATION) -> None:
        if population < 4:
            raise InputError(f"a population of an optimiser has at least 4 candidates; got {population}")
        if not design.goals:
            raise InputError(f"design '{design.name}' has no objective: add a table [objectives.NAME]")
        if seed < 0:
            raise InputError(f"a seed is 0 or more; got {seed}")
        self.space = SearchSpace(design.parameters)
        self._design = design
        self._population = population
        self._start = 0
        self._generation: Any = None
        single = len(design.goals) == 1 and bool((self.space.levels == 0).any())
        self.method = "de" if single else "nsga2"  #: differential evolution or NSGA-II, as named in results
        self._make_algorithm(seed)

    def ask(self) -> list[tuple[int, dict[str, Value]]]:
        """(number, values) of the next generation; empty if nothing new can be found.

        Repeated calls before `tell` return the same.
        """
        if self._generation is None:
            self._generation = self._propose()
            if self._generation is not None:
                self._new.old.update(point.tobytes() for point in self._generation.get("X"))
        if self._generation is None:
            return []
        return [(self._start + n, self.space.values(point)) for n, point in enumerate(self._generation.get("X"))]

    def tell(self, evaluations: Sequence[Evaluation]) -> None:
        """Evaluations of all candidates of the last `ask`, in any order; InputError if some are missing."""
        count = 0 if self._generation is None else len(self._generation)
        ordered = sorted(evaluations, key=lambda evaluation: evaluation.number)
        if not count or [evaluation.number for evaluation in ordered] != list(range(self._start, self._start + count)):
            raise InputError(
                f"the optimiser asked for {count} candidates, from number {self._start} on: report all of their "
                "results first"
            )
        goals = [(goal.name, -1.0 if goal.sense == "maximise" else 1.0) for goal in self._design.goals]
        costs = [[sign * one.objectives[name] if one.valid else 0.0 for name, sign in goals] for one in ordered]
        self._generation.set("F", np.array(costs))
        self._generation.set("G", np.array([[measure_violation(one, self._design.bounds)] for one in ordered]))
        for individual in self._generation:
            individual.evaluated.update({"F", "G"})
        self._algorithm.tell(infills=self._generation)
        self._start += count
        self._generation = None

    def _propose(self) -> Any:
        """pymoo's next generation; None if it has nothing new."""
        if self.method == "nsga2":
            return self._algorithm.ask()  # calls `_new` itself
        for _ in range(_MAX_IDLE_GENERATIONS):
            found = self._algorithm.ask()
            self._change_old(found)
            new = ~self._new.find_old(found)
            if new.any():
                return found[new]  # each keeps the parent it may replace
        return None

    def _change_old(self, found: Any) -> None:
        """Mutate the children in `found` that the run had before, until they are new."""
        for _ in range(_MAX_MUTATIONS):
            old = found[self._new.find_old(found)]
            if not len(old):
                return
            self._change(self._algorithm.problem, old, random_state=self._algorithm.random_state)
            old.set("X", self.space.snap(old.get("X")))

    def _make_algorithm(self, seed: int) -> None:
        from pymoo.algorithms.moo.nsga2 import NSGA2  # imports in 1.5 s: only once the design is valid
        from pymoo.algorithms.soo.nonconvex.de import DE, Variant
        from pymoo.core.problem import Problem
        from pymoo.core.termination import NoTermination
        from pymoo.operators.control import NoParameterControl

        axes = len(self.space.parameters)
        problem = Problem(n_var=axes, n_obj=len(self._design.goals), n_ieq_constr=1, xl=0.0, xu=1.0)
        self._new = NewOnly()
        first, snap = self._first_generation(seed), Snap(self.space)
        if self.method == "de":
            variant = Variant(selection="best", F=0.7, CR=0.9, control=NoParameterControl, repair=snap)
            variant.mutation, self._change = MixedMutation(self.space, prob=0.1), MixedMutation(self.space)
            self._algorithm = DE(pop_size=self._population, sampling=first, variant=variant)
        else:
            self._algorithm = NSGA2(
                pop_size=self._population, sampling=first, crossover=MixedCrossover(self.space),
                mutation=MixedMutation(self.space), repair=snap, eliminate_duplicates=self._new,
            )  # fmt: skip
        self._algorithm.setup(problem, seed=seed, termination=NoTermination(), verbose=False)

    def _first_generation(self, seed: int) -> np.ndarray[Any, np.dtype[np.float64]]:
        random, count, axes = np.random.default_rng(seed), self._population, len(self.space.parameters)
        cells = random.permuted(np.tile(np.arange(count), (axes, 1)), axis=1).T
        return self.space.snap((cells + random.random((count, axes))) / count)


# --------------------------------------------------------------------------------------------------
# A run of an optimiser: candidates are evaluated, or taken from earlier results.


Evaluate = Callable[[Iterable[tuple[int, Mapping[str, Value]]]], Iterable[Evaluation]]


def optimise(
    optimiser: Optimiser, evaluate: Evaluate, known: Mapping[int, Evaluation], count: int
) -> Iterator[Evaluation]:
    """Evaluate candidates 0 to `count` - 1 of a run, except those in `known`; yields each as it arrives.

    optimiser  new
    evaluate   evaluates (number, values) of a generation, in any order
    known      number → stored evaluation of an earlier run with the same design, seed and population

    The optimiser is replayed with the stored evaluations, so that an interrupted run continues as an uninterrupted one.
    Ends early if nothing new can be found. Raises RecordingError if the known evaluations are not of this optimiser.
    """
    while (jobs := optimiser.ask()) and jobs[0][0] < count:
        wanted = [(number, values) for number, values in jobs if number < count]
        found = [known[number] for number, _ in wanted if number in known]
        check_values(dict(wanted), found)
        for evaluation in evaluate([(number, values) for number, values in wanted if number not in known]):
            found.append(evaluation)
            yield evaluation
        if len(found) < len(jobs):
            return
        optimiser.tell(found)
