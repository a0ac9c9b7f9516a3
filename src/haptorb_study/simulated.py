"""A simulated participant: a hand that trembles and a sense that errs, and nothing to go by but what the device gives.

Looking for a summit, it goes over the dome, then probes about the best place. Every probe is a force as felt: with an
error of magnitude and of direction, and with a part of the pen's weight that people do not take out. From its slant a
person who knows the map estimates how far the summit is and where. The last probes count most. Then the place is
recalled, gone to and reported; recall errs little at the top, which is a landmark, and more away from it, in some
trials much more than in others.

CALIBRATED, not predicted: `recall`, `recall_reach_deg`, `recall_spread`, `gravity_left`, `probes`, `forgetting` and
`motor_noise` were chosen once so that 6 participants × 50 trials give the errors that Zárate 2020 measured (2.5, 5.7,
6.5, 7.2 mm at θ = 0, 18, 36, 54 deg), on layout 1-8-8-8. With them 48 participants of 8 seeds give 2.3, 5.6, 6.4 and
6.8 mm (standard deviations 1.3, 4.3, 4.7 and 5.0; the paper's are 1.4, 4.6, 5.2 and 5.1). Single groups of six scatter
about that: about half of the seeds lie within one standard error at all four angles, among them the default 0. The
just-noticeable differences are from the literature. So it may say how many people a study needs, or which of two
designs is likely found more exactly; it cannot confirm the paper.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, final

import numpy as np
from sqlalchemy.engine import Engine

from haptorb.arrays import Array
from haptorb.cluster import open_cluster, run_jobs, spawn_context
from haptorb.control.allocation import tool_choice
from haptorb.devices.base import State, rotation_to_axis
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import InputError
from haptorb.simulation.parts import GRAVITY
from haptorb.worlds.base import World, WrenchPart
from haptorb.worlds.dome import Dome, overlaps
from haptorb_study.analysis import PersonMeasures, list_thresholds
from haptorb_study.columns import Columns, place_answers
from haptorb_study.order import has_set_points, plan, procedure_of
from haptorb_study.procedures import Answer, FixedOrder, InterleavedProcedures, Procedure, Prompt
from haptorb_study.session import StoredSession
from haptorb_study.statistics import EXACT_PEOPLE, PairTest, check_test, decide_p, fewest_people
from haptorb_study.study_file import CLAIMS, MEASURES, SetPoint, Study, directions, nearest, unit_of

__all__ = [
    "ADAPTIVE",
    "FELT_SHARE",
    "MOST_PEOPLE",
    "PEOPLE",
    "DeliveredForce",
    "Forecast",
    "GroupPower",
    "Overlap",
    "Participant",
    "Power",
    "Traits",
    "Unfelt",
    "answer_rest",
    "answer_study",
    "find_unfelt",
    "forecast",
    "list_columns",
    "load_squared",
    "overlap",
    "power",
    "power_of",
    "rehearse",
    "simulate_pool",
    "simulate_value",
]


# --------------------------------------------------------------------------------------------------
# What a trial's world really feels like at a place: asked of the controller's model, given by the exact device.


@final
class DeliveredForce:
    """Force on a radial tool, current limits and model errors included; at rest, cold.

    The same chain as `haptorb.force_map`, as a vector and one place at a time.
    """

    def __init__(
        self, device: SphericalElectromagnet, world: World, model: str | None = None, render: WrenchPart | None = None
    ) -> None:
        self._device, self._world = device, world.for_device(device)
        self._model = device.check_model(model or device.models[0])
        choice = tool_choice(device, render)
        self._allocator = choice.allocators[choice.choose_part(world)]

    def force(self, direction: Array) -> Array:
        """(3,) force [N] on a tool in contact in `direction` (3,), a unit vector."""
        state = State.at(direction * self._device.contact_distance)
        asked = self._world.wrench(state)
        currents = self._allocator.allocate(self._device.wrench_map(state, self._model), asked).currents
        force: Array = self._device.wrench_map(state, self._device.models[0]).wrench(currents)[:3]
        return force


_ONE_SIGMA = 1 / (0.6745 * 2**0.5)  # a difference noticed in 75 % of the pairs, as the spread of a single sensation


@dataclass(frozen=True)
class Traits:
    """The properties of a person; the defaults are those of a typical one."""

    force_jnd: float = 0.085  #: relative; middle of 7 to 10 %
    direction_jnd_deg: float = 22.0  #: of 18 to 32 deg
    detection: float = 0.03  #: [N] less is not felt; assumed
    gravity_left: float = 0.45  #: share of the pen's weight that is taken for the dome's force, on average; calibrated
    motor_noise: float = 1.0e-3  #: spread of a placed pen [m] per direction; calibrated
    tremor: float = 0.15e-3  #: [m] per direction; assumed
    probes: int = 14  #: forces compared about the best place; calibrated
    forgetting: float = 0.16  #: what the newest probe counts at least; calibrated
    recall: float = 3.5e-3  #: typical spread of recalling a place away from the top [m] per direction; calibrated
    recall_reach_deg: float = 9.5  #: how fast the top stops helping; calibrated
    recall_spread: float = 0.6  #: of the logarithm of a trial's recall error; calibrated
    lapse: float = 0.01  #: share of forced choices answered without attention; assumed
    force_exponent: float = 0.8  #: of estimated over true strength; assumed
    between: float = 0.12  #: how much people differ: of the logarithm of every trait above

    def draw_person(self, draw: np.random.Generator) -> Traits:
        """One person, drawn at random."""
        names = ("force_jnd", "direction_jnd_deg", "gravity_left", "motor_noise", "tremor", "recall")
        factors = np.exp(self.between * draw.standard_normal(len(names)))
        return replace(self, **{n: getattr(self, n) * float(f) for n, f in zip(names, factors, strict=True)})


@final
class Participant:
    """Answers prompts of one study; the same seed and the same prompt give the same answer, in any order."""

    def __init__(self, study: Study, seed: tuple[int, ...], traits: Traits | None = None) -> None:
        self._study, self._seed = study, seed
        self._device: SphericalElectromagnet = study.load_device()
        self.traits = (traits or Traits()).draw_person(np.random.default_rng([*seed, 0]))
        self._felt: dict[tuple[str, int, float], DeliveredForce] = {}
        self._ways = directions(study.points)
        self._coarse: dict[tuple[str, int, float], Array] = {}

    def answer(self, prompt: Prompt, number: int) -> Answer:
        """The answer to trial `number`; it draws from a stream of its own, so a resumed session continues alike."""
        draw = np.random.default_rng([*self._seed, 1, number])
        if prompt.interval:
            return Answer(self._compare_intervals(prompt, draw), None, 2.0 + float(draw.exponential(1.5)))
        if self._study.procedure == "magnitude":
            return Answer(self._estimate(prompt, draw), None, 2.0 + float(draw.exponential(1.5)))
        if prompt.high:
            return Answer(self._rate(prompt, draw), None, 2.0 + float(draw.exponential(1.5)))
        position = self._draw_position(prompt, draw)
        seconds = 4.0 + float(draw.gamma(4.0, 1.5))
        value = nearest(self._study.points, position) if prompt.wants_number else None
        x, y, z = position.tolist()
        return Answer(value, (x, y, z), seconds)

    def _draw_position(self, prompt: Prompt, draw: np.random.Generator) -> Array:
        """(3,) where the tool's magnet is when the answer is given [m]."""
        traits, contact = self.traits, self._device.contact_distance
        sharpness = self._sharpness(prompt)
        guess = self._ways[
            int(np.argmax(self._sweep_dome(prompt) * (1 + self._noise * draw.standard_normal(len(self._ways)))))
        ]
        # How much of the pen's weight is taken out differs from trial to trial, by as much as is left on average.
        left = traits.gravity_left * (1 + float(draw.standard_normal()))
        weight = left * self._device.tool.mass * GRAVITY
        for n in range(traits.probes):
            at = _move_on_sphere(guess, np.radians(4.0) * draw.standard_normal(2))
            felt = self._sense_force(prompt, at, weight, draw)
            away, out = felt - (felt @ at) * at, float(felt @ at)
            sideways = float(np.linalg.norm(away))
            if np.hypot(sideways, out) < traits.detection:
                continue
            # The map leans outwards by as much as the summit is away: tan kα = 2 F_t / F_r.
            alpha = np.arctan2(2 * sideways, out) / sharpness
            summit = np.cos(alpha) * at - (np.sin(alpha) / max(sideways, 1e-12)) * away
            share = max(1.0 / (n + 1), traits.forgetting)
            guess = (1 - share) * guess + share * summit
            guess /= np.linalg.norm(guess)
        theta = np.degrees(np.arccos(np.clip(guess[2], -1, 1)))
        recall = traits.recall * (1 - np.exp(-((theta / traits.recall_reach_deg) ** 2)))
        recall *= np.exp(traits.recall_spread * draw.standard_normal())
        spread = np.sqrt(recall**2 + traits.motor_noise**2 + traits.tremor**2)
        place = _move_on_sphere(guess, spread / contact * draw.standard_normal(2))
        limit = self._device.workspace_half_angle + np.radians(10.0)
        position: Array = contact * _limit_tilt(place, float(limit))
        return position

    @property
    def _noise(self) -> float:
        return self.traits.force_jnd * _ONE_SIGMA

    def _sharpness(self, prompt: Prompt) -> float:
        world = self._study.make_world(prompt.condition, prompt.set_point, prompt.level or None)
        return 90.0 / float(world.half_width_deg) if isinstance(world, Dome) else 1.0

    def _force_model(self, prompt: Prompt) -> DeliveredForce:
        key = (prompt.condition, prompt.set_point or self._study.points[0].number, prompt.level)
        if key not in self._felt:
            world = self._study.make_world(key[0], key[1], prompt.level or None)
            model = self._study.model_on(self._device)
            self._felt[key] = DeliveredForce(self._device, world, model, self._study.render or None)
        return self._felt[key]

    def _sweep_dome(self, prompt: Prompt) -> Array:
        """(n,) push [N] at every set-point, as a pen that goes over the dome meets it."""
        key = (prompt.condition, prompt.set_point, prompt.level)
        if key not in self._coarse:
            felt = self._force_model(prompt)
            self._coarse[key] = np.array([felt.force(way) @ way for way in self._ways])
        return self._coarse[key]

    def _sense_force(self, prompt: Prompt, at: Array, weight: float, draw: np.random.Generator) -> Array:
        """(3,) force as felt [N] at `at`, a unit vector, `weight` [N] of the pen mistaken for it."""
        traits = self.traits
        force: Array = self._force_model(prompt).force(at) - np.array([0.0, 0.0, weight])
        size = float(np.linalg.norm(force))
        if size < 1e-9:
            return force
        tilt = np.radians(traits.direction_jnd_deg) * _ONE_SIGMA * draw.standard_normal(2)
        felt: Array = size * (1 + self._noise * float(draw.standard_normal())) * _move_on_sphere(force / size, tilt)
        return felt

    def _compare_intervals(self, prompt: Prompt, draw: np.random.Generator) -> int:
        """Interval, 1 or 2, that felt stronger."""
        if draw.random() < self.traits.lapse:
            return int(draw.integers(1, 3))
        if prompt.other:
            one, two = prompt, replace(prompt, condition=prompt.other)
        else:
            reference = self._study.levels.reference if self._study.levels else 0.0
            one, two = prompt, replace(prompt, level=reference)
        a, b = (self._strength(which) * (1 + self._noise * float(draw.standard_normal())) for which in (one, two))
        return prompt.interval if a > b else 3 - prompt.interval

    def _strength(self, prompt: Prompt) -> float:
        way = np.array(self._study.point(prompt.set_point or self._study.points[0].number).direction)
        return float(np.linalg.norm(self._force_model(prompt).force(way)))

    def _rate(self, prompt: Prompt, draw: np.random.Generator) -> int:
        """The stronger, the better: all that a simulated participant can have an opinion on. 1 N is the best."""
        liking = min(1.0, self._strength(prompt)) + 0.1 * float(draw.standard_normal())
        return int(np.clip(round(prompt.low + liking * (prompt.high - prompt.low)), prompt.low, prompt.high))

    def _estimate(self, prompt: Prompt, draw: np.random.Generator) -> float:
        """A number for the strength: by a power law (Stevens 1957), on a scale of one's own, 100 for 1 N or so.

        Of two digits, as most people answer.
        """
        scale = 100.0 * float(np.exp(0.5 * np.random.default_rng([*self._seed, 2]).standard_normal()))
        felt = max(1e-3, self._strength(prompt) * (1 + self._noise * float(draw.standard_normal())))
        estimate = min(float(f"{scale * felt**self.traits.force_exponent:.2g}"), float(prompt.high))
        return estimate if prompt.decimal else max(prompt.low, round(estimate))


def _move_on_sphere(way: Array, step: Array) -> Array:
    """`way` (3,), a unit vector, moved over the sphere by `step` (2,) [rad]."""
    other = np.array([0.0, 1.0, 0.0]) if abs(way[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    one = np.cross(other, way)
    one /= np.linalg.norm(one)
    size = float(np.hypot(*step))
    if size == 0.0:
        return way
    side = (step[0] * one + step[1] * np.cross(way, one)) / size
    moved: Array = np.cos(size) * way + np.sin(size) * side
    return moved


def _limit_tilt(way: Array, limit: float) -> Array:
    """`way`, or where it leaves the workspace [rad from the top], the workspace's rim below it."""
    if way[2] >= np.cos(limit):
        return way
    round_ = np.array([way[0], way[1], 0.0])
    round_ /= max(float(np.linalg.norm(round_)), 1e-12)
    rim: Array = np.sin(limit) * round_ + np.array([0.0, 0.0, np.cos(limit)])
    return rim


# --------------------------------------------------------------------------------------------------
# Before anyone sits down: how long it takes, whether the coils stay cool enough, and which maps reach into each other.
#
# The heat is that of the device's own thermal model under an assumed hand: for half of every trial the tool is
# somewhere
# within the map, equally often at every angle from its summit and all round it, in contact; else no current flows.


_NOTHING = 1e-6  #: [N], [N·m]: less is nothing
FELT_SHARE = 0.5  #: of a trial's time in which the tool is within the map; an assumption
_PAUSES = (2.0, 5.0, 10.0, 20.0, 40.0, 80.0)


@dataclass(frozen=True)
class Forecast:
    """What a session will be like."""

    trials: int
    seconds: float  #: with pauses and breaks
    hottest_coil: str
    peak: float  #: winding temperature [K]
    warn: float  #: [K]
    derate: float  #: [K]
    pause: (
        float | None
    )  #: more pause after each trial [s] with which it stays below derating; None: 80 s are not enough

    @property
    def holds(self) -> bool:
        """Whether no current will have to be reduced."""
        return self.peak < self.derate

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {
            "trials": self.trials, "duration_s": self.seconds, "hottest_coil": self.hottest_coil,
            "peak_winding_degc": self.peak - 273.15, "warn_at_degc": self.warn - 273.15,
            "derate_at_degc": self.derate - 273.15, "more_pause_s": self.pause, "holds": self.holds,
        }  # fmt: skip

    @property
    def sentence(self) -> str:
        """For people."""
        c = self.peak - 273.15
        begin = (
            f"{self.trials} trials, about {self.seconds / 60:.0f} min; hottest winding '{self.hottest_coil}' {c:.0f} °C"
        )
        if self.holds:
            word = "stays below" if self.peak < self.warn else "warns, but stays below"
            return f"{begin}: {word} derating at {self.derate - 273.15:.0f} °C"
        cure = "longer pauses do not help: reduce the moment"
        if self.pause is not None:
            cure = f"{self.pause:g} s more pause after each trial prevent this"
        return f"{begin}: forces will be reduced (derating at {self.derate - 273.15:.0f} °C); {cure}"


@dataclass(frozen=True)
class Overlap:
    """How far maps that are felt one at a time reach into each other."""

    pairs: int
    worst: float  #: [deg]
    set_points: tuple[int, int]

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {"pairs": self.pairs, "worst_deg": self.worst, "set_points": list(self.set_points)}

    @property
    def sentence(self) -> str:
        """For people."""
        a, b = self.set_points
        return (
            f"{self.pairs} pairs of set-points have overlapping maps, set-points {a} and {b} by "
            f"{self.worst:.1f} deg: render them one after the other, not several at once"
        )


@dataclass(frozen=True)
class Unfelt:
    """A condition in which nothing can be felt, or no difference between levels, at the place of its trials.

    Also one that is declared to be without force, and is not.
    """

    condition: str
    theta_deg: float  #: of the set-point
    parameter: str  #: that is varied without effect; "": there is no force at all
    most: float  #: [N] greatest force there, or [N·m] torque where only a torque is rendered
    control: bool = False  #: whether it is declared to be without force (`no_force = true`)

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {
            "condition": self.condition, "theta_deg": self.theta_deg, "parameter": self.parameter or None,
            "greatest": self.most, "no_force": self.control,
        }  # fmt: skip

    @property
    def sentence(self) -> str:
        """For people."""
        where = f"condition '{self.condition}', set-point at θ = {self.theta_deg:g} deg"
        if self.control:
            return (
                f"{where}: no_force = true, but the world renders up to {self.most:.3g} N (or N·m of torque) there; "
                "set its parameters so that it renders nothing, or leave out no_force"
            )
        if not self.parameter:
            return (
                f"{where}: the world renders nothing within reach of it, so there is nothing to answer to; a control "
                "condition without force says no_force = true"
            )
        return (
            f"{where}: levels of '{self.parameter}' change nothing that is rendered there, so that every answer is a "
            "guess; choose a set-point within the world, or another parameter"
        )


def find_unfelt(study: Study) -> tuple[Unfelt, ...]:
    """Conditions whose world gives nothing at the place of a trial or, if a level is varied, the same at each level.

    A condition with `no_force` has to give nothing, and is found where it gives something.
    """
    device, found = study.load_device(), []
    levels = study.levels
    varied: list[float] = []
    if levels is not None and study.procedure in ("constant", "staircase", "bayesian", "magnitude"):
        chosen = study.procedure in ("constant", "magnitude")
        more = [m for m in (levels.most, levels.start) if m is not None]
        varied = list(levels.values) if chosen else [levels.reference + m for m in more]
    for condition in study.conditions:
        for point in study.points if has_set_points(study) else study.points[:1]:
            levels_here = [levels.reference, *varied] if levels is not None and varied else [None]
            made = [study.make_world(condition.name, point.number, level).for_device(device) for level in levels_here]
            widest = max(made, key=lambda world: world.cut_off_deg if isinstance(world, Dome) else 0.0)
            states = _list_states(device, point, widest)
            fields = [_sample_wrench(device, study, world, states) for world in made]
            most = max(float(np.abs(field).max(initial=0.0)) for field in fields)
            change = max((float(np.abs(field - fields[0]).max(initial=0.0)) for field in fields[1:]), default=most)
            if condition.no_force:
                if most >= _NOTHING:
                    found.append(Unfelt(condition.name, point.theta_deg, "", most, control=True))
            elif most < _NOTHING or change < _NOTHING:
                parameter = levels.parameter if levels is not None and varied else ""
                found.append(Unfelt(condition.name, point.theta_deg, parameter, most))
    return tuple(found)


def _sample_wrench(device: SphericalElectromagnet, study: Study, world: World, states: list[State]) -> Array:
    """(n, 6) what is rendered of the wrench of `world` [N, N·m] at `states`."""
    part = tool_choice(device, study.render or None).choose_part(world)
    kept = np.array([part != "torque"] * 3 + [part != "force"] * 3, dtype=float)
    found: Array = np.array([world.wrench(state).copy() for state in states]).reshape(-1, 6) * kept
    return found


def _list_states(device: SphericalElectromagnet, point: SetPoint, world: World) -> list[State]:
    """Where the tool is felt to be within the map of `point`, in contact, equally often at every angle."""
    cut_off = world.cut_off_deg if isinstance(world, Dome) else 54.0
    turn, found = rotation_to_axis(point.direction), []
    for alpha in np.radians((np.arange(6) + 0.5) / 6 * cut_off):
        for phi in np.arange(6) * np.pi / 3:
            way = turn @ np.array([np.sin(alpha) * np.cos(phi), np.sin(alpha) * np.sin(phi), np.cos(alpha)])
            if np.arccos(way[2]) <= device.workspace_half_angle + np.radians(15):
                found.append(State.at(way * device.contact_distance))
    return found


def overlap(study: Study) -> Overlap | None:
    """The overlap of the domes of all set-points in the widest condition; None where there is none."""
    if not has_set_points(study):
        return None
    device, found = study.load_device(), []
    for condition in study.conditions:
        domes = [study.make_world(condition.name, point.number).for_device(device) for point in study.points]
        pairs = overlaps([dome for dome in domes if isinstance(dome, Dome)])
        if pairs:
            i, j, worst = max(pairs, key=lambda pair: pair[2])
            found.append(Overlap(len(pairs), worst, (study.points[i].number, study.points[j].number)))
    return max(found, key=lambda one: one.worst) if found else None


def load_squared(device: SphericalElectromagnet, study: Study, prompt: Prompt) -> Array:
    """(m,) mean square current [A²] while the tool is within the map of `prompt`, in contact."""
    point = study.point(prompt.set_point or study.points[0].number)
    world = study.make_world(prompt.condition, point.number, prompt.level or None).for_device(device)
    choice = tool_choice(device, study.render or None)
    allocator = choice.allocators[choice.choose_part(world)]
    squares = []
    model = study.model_on(device) or device.models[0]
    for state in _list_states(device, point, world):
        given = allocator.allocate(device.wrench_map(state, model), world.wrench(state))
        squares.append(given.currents**2)
    mean: Array = np.mean(squares, axis=0)
    return mean


def forecast(study: Study, participant: int = 0) -> Forecast:
    """Duration and heat of one session, as the `participant`-th person would have it."""
    device = study.load_device()
    prompts = _list_prompts(study, participant)
    known: dict[tuple[str, int, float], Array] = {}
    loads = []
    for prompt in prompts:
        key = (prompt.condition, prompt.set_point, prompt.level)
        if key not in known:
            known[key] = FELT_SHARE * load_squared(device, study, prompt)
        loads.append(known[key])
    trials = study.trials
    peaks = _peaks(device, loads, prompts, trials.expected_seconds, trials.pause_seconds)
    hottest, pause = int(np.argmax(peaks)), None
    heat = device.coils.heat
    if peaks[hottest] >= heat.derate:
        for more in _PAUSES:
            longer = _peaks(device, loads, prompts, trials.expected_seconds, trials.pause_seconds + more)
            if longer.max() < heat.derate:
                pause = more
                break
    seconds = len(prompts) * (trials.expected_seconds + trials.pause_seconds) + sum(p.pause for p in prompts)
    return Forecast(
        len(prompts), seconds, device.coils.names[hottest], float(peaks[hottest]), heat.warn, heat.derate, pause
    )


def _list_prompts(study: Study, participant: int) -> list[Prompt]:
    """The trials in their order; an adaptive procedure at its greatest length and first level."""
    procedure = procedure_of(study, plan(study, participant))
    lists = [
        iter(part.prompts if isinstance(part, FixedOrder) else [part.prompt] * part.expected)
        for part in procedure.parts
    ]
    if not isinstance(procedure, InterleavedProcedures):
        return [prompt for prompts in lists for prompt in prompts if prompt is not None]
    found = [prompt for turn in procedure.turns if (prompt := next(lists[turn], None)) is not None]
    return [replace(prompt, pause=procedure.pauses.get(n, prompt.pause)) for n, prompt in enumerate(found)]


def _peaks(
    device: SphericalElectromagnet, loads: list[Array], prompts: list[Prompt], seconds: float, pause: float
) -> Array:
    """(m,) greatest winding temperature [K] over the session, from cold; resistance follows the temperature."""
    coils, heat = device.coils, device.coils.heat
    m = device.channels
    model = heat.network(m)
    n = model.nodes
    count = max(1, round(seconds))
    step = model.step(seconds / count)
    rest = model.step(pause)[:, :n] if pause else np.eye(n)
    rise, peak = np.zeros(n), np.zeros(m)
    for load, prompt in zip(loads, prompts, strict=True):
        if prompt.pause:
            rise = model.step(prompt.pause)[:, :n] @ rise
        for _ in range(count):
            power = load * coils.resistance_at(heat.ambient + rise[:m])
            rise = step[:, :n] @ rise + step[:, n:] @ power
            peak = np.maximum(peak, rise[:m])
        rise = rest @ rise
    return heat.ambient + peak


# --------------------------------------------------------------------------------------------------
# A study with simulated participants: the same database, the same procedures, marked as simulated throughout.


def rehearse(
    engine: Engine,
    study: Study,
    people: int = 6,
    *,
    seed: int = 0,
    first: int = 1,
    traits: Traits | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Let simulated participants SIM01, SIM02 ... (from `first`) sit the study; returns trials answered.

    `progress` receives (trials done, trials in all at most). A rehearsal that was interrupted is resumed.
    """
    if not 1 <= people <= 10_000 or seed < 0 or first < 1:
        raise InputError(f"people must be 1 to 10000, seed 0 or more, first 1 or more; got {people}, {seed}, {first}")
    answered = 0
    for n in range(first, first + people):
        with StoredSession(engine, study, f"SIM{n:02d}", simulated=True) as session:
            done, left = answered, session.procedure.expected

            def report_trials(k: int, done: int = done, left: int = left) -> None:
                if progress is not None:
                    progress(done + k, people * left)

            answered += answer_rest(session, Participant(study, (seed, n), traits), report_trials)
    return answered


def answer_rest(session: StoredSession, participant: Participant, progress: Callable[[int], None] | None = None) -> int:
    """Answer everything that is left of `session`; returns how many trials that were."""
    answered = 0
    while (prompt := session.prompt) is not None:
        session.answer(participant.answer(prompt, session.number), driver="sim")
        answered += 1
        if progress is not None:
            progress(answered)
    return answered


# --------------------------------------------------------------------------------------------------
# The power of a test over people for groups out of a pool, and the fewest people that reach a wanted one.


MOST_PEOPLE = 500  #: beyond which nothing is searched
_SLOW = 2000  #: groups at most for a test that takes long


@final
class GroupPower:
    """By number of people, the share of groups of so many out of `pool` in which `test` shows p < `alpha`.

    `seed` and the number of people decide what is drawn, so a power does not depend on which others were asked for.
    """

    def __init__(self, pool: Array, alpha: float, groups: int, seed: tuple[int, ...], test: PairTest = "t") -> None:
        self._pool, self._alpha, self._groups, self._seed, self._test = pool, alpha, groups, seed, test
        self.found: dict[int, float] = {}  #: what was computed so far

    def power(self, people: int) -> float:
        """Of groups of `people`."""
        if people not in self.found:
            draw = np.random.default_rng([*self._seed, people])
            count = self._groups
            if self._test == "sign-flip" and people > EXACT_PEOPLE:
                count = min(count, _SLOW)  # thousands of sign patterns for each group
            groups = self._pool[draw.integers(0, len(self._pool), (count, people))]
            self.found[people] = float(np.mean(decide_p(groups, self._test) < self._alpha))
        return self.found[people]

    @property
    def least(self) -> int:
        """Fewest people with whom the test can show p < alpha at all."""
        return fewest_people(self._alpha, self._test)

    def find_fewest(self, wanted: float, start: int) -> int | None:
        """The fewest people who reach the power `wanted`, searched from `start` on; None: more than MOST_PEOPLE.

        Power is taken to grow with the number of people, as it does but for the last step of small numbers.
        """
        low, high = self.least - 1, min(max(start, self.least), MOST_PEOPLE)
        while self.power(high) < wanted:
            if high == MOST_PEOPLE:
                return None
            low, high = high, min(2 * high, MOST_PEOPLE)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if self.power(middle) >= wanted else (middle, high)
        return high


# --------------------------------------------------------------------------------------------------
# One simulated participant who sits the whole study in memory, and what the measures make of the answers.


ADAPTIVE = ("staircase", "bayesian")  #: procedures whose thresholds are their own
_CODE = "SIM"


def simulate_value(
    study: Study, seed: tuple[int, ...], ordinal: int, measure: str, between: tuple[str, str] | None
) -> float:
    """a − b of one simulated participant, the `ordinal`-th, or the measure itself; NaN where something is missing.

    `seed` decides everything that is drawn, so it matters neither where nor in which order participants are simulated.
    """
    procedure, responses = answer_study(study, seed, ordinal)
    main = list_columns(study, responses)
    thresholds = list_thresholds({_CODE: procedure}) if study.procedure in ADAPTIVE else None
    found = PersonMeasures(study, main, [_CODE], thresholds).compare(measure, between).differences
    return float(found[0]) if len(found) else float("nan")


def answer_study(study: Study, seed: tuple[int, ...], ordinal: int) -> tuple[Procedure, list[tuple[Prompt, Answer]]]:
    """The procedure after all trials of one simulated participant, and what was asked and answered in turn."""
    somebody = Participant(study, seed)
    procedure: Procedure = procedure_of(study, plan(study, ordinal))
    responses: list[tuple[Prompt, Answer]] = []
    while (prompt := procedure.prompt) is not None:
        answer = somebody.answer(prompt, len(responses))
        procedure = procedure.record_answer(answer)
        responses.append((prompt, answer))
    return procedure, responses


def list_columns(study: Study, responses: Iterable[tuple[Prompt, Answer]], code: str = _CODE) -> Columns:
    """What measures read of the tidy table, for the participant `code`; without practice, as in every analysis."""
    main = [(prompt, answer) for prompt, answer in responses if prompt.phase != "practice"]
    points = {point.number: point for point in study.points}
    ways = np.array([points[p.set_point].direction if p.set_point else (np.nan,) * 3 for p, _ in main]).reshape(-1, 3)
    place = np.array([a.position or (np.nan,) * 3 for _, a in main], dtype=float).reshape(-1, 3)
    number = np.array([p.set_point for p, _ in main])
    contact = study.load_device().contact_distance
    answer = np.array([np.nan if a.value is None else a.value for _, a in main], dtype=float)
    return {
        "participant": np.full(len(main), code), "set_point": number, "answer": answer,
        "condition": np.array([p.condition for p, _ in main]), "other": np.array([p.other for p, _ in main]),
        "level": np.array([p.level for p, _ in main]), "interval": np.array([p.interval for p, _ in main]),
        "theta_deg": np.array([points[p.set_point].theta_deg if p.set_point else np.nan for p, _ in main]),
        "correct": np.where(np.isfinite(answer), answer == number, np.nan),
        "x_m": place[:, 0], "y_m": place[:, 1], "z_m": place[:, 2],
        "distance_mm": 1e3 * np.linalg.norm(place_answers(study, answer, place) - contact * ways, axis=1),
    }  # fmt: skip


# --------------------------------------------------------------------------------------------------
# Where simulated participants are computed: in this process, on all its cores, or on a Dask cluster.
#
# Each participant has a seed of its own and results are kept by number, so all three give the same, bit for bit.


_SHARES = 8  #: parts of the work per process, so that none waits long for the last

Job = tuple[bytes, tuple[tuple[tuple[int, ...], int], ...], str, tuple[str, str] | None]


def simulate_pool(
    study: Study, pool: int, seed: int, measure: str, between: tuple[str, str] | None, *, processes: int = 1,
    scheduler: str | None = None, progress: Callable[[int, int], None] | None = None,
) -> list[float]:  # fmt: skip
    """Value of `measure` of each of `pool` simulated participants, in `processes` or on the cluster of `scheduler`.

    Raises InputError for a scheduler that does not answer or has other versions than this computer.
    """
    if processes < 1:
        raise InputError(f"processes must be 1 or more; got {processes}")
    people: list[tuple[tuple[int, ...], int]] = [((seed, n + 1), n) for n in range(pool)]
    found = [math.nan] * pool

    def keep(values: dict[int, float], done: int) -> int:
        for n, value in values.items():
            found[n] = value
        if progress is not None:
            progress(done + len(values), pool)
        return done + len(values)

    done = 0
    if scheduler is None and min(processes, pool) == 1:
        for who, n in people:
            done = keep({n: simulate_value(study, who, n, measure, between)}, done)
        return found
    import cloudpickle

    packed: bytes = cloudpickle.dumps(study)  # a world of the user's own comes with its code
    at_once = processes if scheduler is None else 8
    size = max(1, math.ceil(pool / (at_once * _SHARES)))
    jobs: list[Job] = [(packed, tuple(people[k : k + size]), measure, between) for k in range(0, pool, size)]
    for values in _run_processes(jobs, processes) if scheduler is None else _run_cluster(jobs, scheduler):
        done = keep(values, done)
    return found


def _run_processes(jobs: list[Job], processes: int) -> Iterator[dict[int, float]]:
    with ProcessPoolExecutor(min(processes, len(jobs)), mp_context=spawn_context()) as workers:
        try:
            for future in as_completed([workers.submit(_simulate_part, *job) for job in jobs]):
                yield future.result()
        except BaseException:
            workers.shutdown(cancel_futures=True)
            raise


def _run_cluster(jobs: list[Job], address: str) -> Iterator[dict[int, float]]:
    with open_cluster(address) as client:
        yield from run_jobs(client, _simulate_job, jobs, after="the result is lost, start again")


def _simulate_job(job: Job) -> dict[int, float]:
    return _simulate_part(*job)


def _simulate_part(
    packed: bytes, people: tuple[tuple[tuple[int, ...], int], ...], measure: str, between: tuple[str, str] | None
) -> dict[int, float]:
    """Number → value of these people."""
    study = _unpack(packed)
    return {n: simulate_value(study, seed, n, measure, between) for seed, n in people}


@cache
def _unpack(packed: bytes) -> Study:
    import cloudpickle

    study: Study = cloudpickle.loads(packed)
    return study


# --------------------------------------------------------------------------------------------------
# How many participants a study needs to detect a difference between two conditions, estimated with simulated ones.
#
# A pool of simulated participants sits the study once; each gives one paired difference. Groups of n are drawn from the
# pool, and the test that the analysis uses (`decide_p`, the same function) is applied to each: its share of p < α is
# the power at n. The fewest people who reach the wanted power are searched below and above the numbers that were asked
# for. What is uncertain in that because the pool is finite is stated, by drawing whole pools from the pool.


PEOPLE = (6, 8, 10, 12, 16, 20, 24, 32, 48)  #: shown unless asked otherwise
_GROUPS = 20_000  #: groups drawn per number of people
_POOLS = 80  #: pools drawn from the pool
_FEWER = 200  #: groups drawn from each of those
_TEST_NAMES = {"t": "Student's paired t test", "sign-flip": "sign-flip test"}


@dataclass(frozen=True)
class Power:
    """What was found; every interval is 95 % over pools."""

    measure: str
    a: str  #: empty, as b is: the measure against zero, over all conditions
    b: str
    pool: int
    difference: float  #: mean of a − b over the pool
    spread: float  #: its standard deviation over people
    alpha: float
    wanted: float
    people: tuple[int, ...]  #: those asked for, and the fewest that reach `wanted`
    power: tuple[float, ...]  #: by people
    low: tuple[float, ...]
    high: tuple[float, ...]
    needed: int | None  #: fewest that reach `wanted`; None: more than MOST_PEOPLE
    needed_95: tuple[int | None, int | None]
    least: int  #: fewest with whom the test can show anything at this alpha
    test: PairTest = "t"
    unit: str = ""  #: of the difference

    @property
    def sentence(self) -> str:
        """For people."""
        most = f"more than {MOST_PEOPLE}"
        low, high = (most if n is None else str(n) for n in self.needed_95)
        needed = most if self.needed is None else f"about {self.needed}"
        floor = ""
        if self.needed == self.least:
            floor = f"; with fewer than {self.least} the test cannot reach p < {self.alpha:g}"
        what = f"{self.a} − {self.b} " if self.a else ""
        return (
            f"{needed} participants (95 %: {low} to {high}) detect {self.measure} {what}= {self.difference:.3g} ± "
            f"{self.spread:.2g}{self.unit and f' {self.unit}'} with a probability of {100 * self.wanted:.0f} % at α = "
            f"{self.alpha:.3g} ({_TEST_NAMES[self.test]}, two-sided){floor}; predicted with {self.pool} SIMULATED "
            "participants, which are not evidence about people"
        )

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        rows = zip(self.people, self.power, self.low, self.high, strict=True)
        return {
            "simulated": True, "measure": self.measure, "unit": self.unit, "a": self.a, "b": self.b, "test": self.test,
            "pool": self.pool,
            "difference": self.difference, "standard_deviation": self.spread, "alpha": self.alpha,
            "wanted_power": self.wanted, "needed": self.needed, "needed_95": list(self.needed_95),
            "least_people": self.least, "searched_up_to": MOST_PEOPLE,
            "power": [{"people": n, "power": p, "interval_95": [low, high]} for n, p, low, high in rows],
        }  # fmt: skip


def power(
    study: Study, between: tuple[str, str] | None = None, measure: str | None = None, *, pool: int = 40,
    people: Sequence[int] | None = None, alpha: float | None = None, wanted: float = 0.8, seed: int = 0,
    test: PairTest | None = None, processes: int = 1, scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Power:  # fmt: skip
    """Power of `study` to see `measure` differ `between` two conditions; `progress` (done, of).

    What is not given is that of the study's plan: its first test, its level divided by the number of its tests (if p is
    corrected), its number of people; without a plan the first two conditions, α = 0.05 and Student's test. `scheduler`
    is the address of a Dask cluster; the result does not depend on where it is computed.

    Raises InputError for a study, condition or measure without one.
    """
    plan = study.plan
    if plan is not None and measure is None and between is None:
        measure, between = plan.tests[0].measure, plan.tests[0].between
    measure, between = _check_question(study, measure, between)
    alpha = alpha if alpha is not None else plan.strictest_alpha if plan else 0.05
    test = test or (plan.test if plan else "t")
    people = people or (tuple(sorted({*PEOPLE, min(plan.participants, MOST_PEOPLE)})) if plan else PEOPLE)
    _check_numbers(people, alpha, wanted, test)
    if isinstance(pool, bool) or not 8 <= pool <= 100_000 or seed < 0:
        raise InputError(f"a pool has 8 to 100000 simulated participants, a seed is 0 or more; got {pool} and {seed}")
    found = simulate_pool(
        study, pool, seed, measure, between, processes=processes, scheduler=scheduler, progress=progress
    )
    return power_of(found, people, alpha, wanted, (measure, *(between or ("", ""))), seed, test,
                    unit_of(measure, study.level_unit))  # fmt: skip


def _check_question(
    study: Study, measure: str | None, between: tuple[str, str] | None
) -> tuple[str, tuple[str, str] | None]:
    """`measure` and conditions, those of the study where they are not given; InputError for what it does not have."""
    known = MEASURES[study.procedure]
    measure = measure or known[0]
    if measure not in known:
        raise InputError(f"procedure '{study.procedure}' has no measure '{measure}'; known: {', '.join(known)}")
    names = [condition.name for condition in study.conditions]
    if between is None and measure in CLAIMS:
        return measure, None
    if len(names) < 2:
        raise InputError(f"study '{study.name}' has one condition: add a second [[conditions]] to compare it with")
    a, b = between or (names[0], names[1])
    for name in (a, b):
        if name not in names:
            raise InputError(f"there is no condition '{name}'; known: {', '.join(names)}")
    if a == b:
        raise InputError(f"a condition cannot be compared with itself ('{a}')")
    return measure, (a, b)


def power_of(
    pairs: Sequence[float], people: Sequence[int] = PEOPLE, alpha: float = 0.05, wanted: float = 0.8,
    what: tuple[str, str, str] = ("difference", "a", "b"), seed: int = 0, test: PairTest = "t", unit: str = "",
) -> Power:  # fmt: skip
    """Power from the paired differences of a pool, for groups of `people` and of the fewest who reach `wanted`.

    `what` is (measure, a, b), `unit` that of the differences.
    """
    _check_numbers(people, alpha, wanted, test)
    d = np.asarray(pairs, dtype=float)
    d = d[np.isfinite(d)]
    if len(d) < 4:
        raise InputError("fewer than 4 simulated participants have a difference: the procedure ends too soon")
    draw = np.random.default_rng([seed, 2])
    # The k-th pool is the k-th resample, the 0th the pool itself; groups come from that pool with replacement.
    pools = np.vstack([d, d[draw.integers(0, len(d), (_POOLS, len(d)))]])
    drawn = [GroupPower(pool, alpha, _FEWER if k else _GROUPS, (seed, 3, k), test) for k, pool in enumerate(pools)]
    whole, parts = drawn[0], drawn[1:]
    needed = whole.find_fewest(wanted, min(people))
    counts = tuple(sorted({*people, *([] if needed is None else [needed])}))
    shares = np.array([[part.power(n) for n in counts] for part in parts])
    low, high = np.percentile(shares, (2.5, 97.5), axis=0)
    ends = sorted(part.find_fewest(wanted, needed or MOST_PEOPLE) or MOST_PEOPLE + 1 for part in parts)
    needed_95 = [None if end > MOST_PEOPLE else end for end in (ends[int(0.025 * _POOLS)], ends[int(0.975 * _POOLS)])]
    return Power(
        *what, len(d), float(d.mean()), float(d.std(ddof=1)), alpha, wanted, counts,
        tuple(whole.power(n) for n in counts), tuple(low.tolist()), tuple(high.tolist()), needed,
        (needed_95[0], needed_95[1]), whole.least, test, unit,
    )  # fmt: skip


def _check_numbers(people: Sequence[int], alpha: float, wanted: float, test: str) -> None:
    """InputError for numbers with which there is no power, before a pool is simulated."""
    if not 0 < alpha < 0.5 or not 0.1 <= wanted < 1:
        raise InputError(f"needs 0 < alpha < 0.5 and 0.1 ≤ power < 1; got {alpha:g} and {wanted:g}")
    if not people or any(isinstance(n, bool) or not isinstance(n, int) or not 2 <= n <= MOST_PEOPLE for n in people):
        raise InputError(
            f"numbers of people must be whole, 2 to {MOST_PEOPLE}; got {', '.join(map(str, people)) or 'none'}"
        )
    check_test(test)
