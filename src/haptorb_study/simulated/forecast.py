"""Forecast of a session: duration, coil temperature, overlap of the maps, and conditions that cannot be felt.

Temperatures follow from the device's thermal model and an assumed motion: for half of every trial the tool is in
contact within the map, uniformly over the angles about its summit; otherwise no current flows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from haptorb.arrays import Array
from haptorb.control.allocation import tool_choice
from haptorb.devices.base import State, rotation_to_axis
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.worlds.base import World
from haptorb.worlds.dome import Dome, overlaps
from haptorb_study.order import plan, procedure_of
from haptorb_study.procedures import FixedOrder, InterleavedProcedures
from haptorb_study.prompts import Prompt
from haptorb_study.set_points import SetPoint
from haptorb_study.study_file import Study
from haptorb_study.trial_lists import has_set_points

__all__ = ["FELT_SHARE", "Forecast", "Overlap", "Unfelt", "find_unfelt", "forecast", "load_squared", "overlap"]


_MIN_WRENCH = 1e-6  #: threshold of a perceptible wrench [N], [N·m]
FELT_SHARE = 0.5  #: assumed fraction of a trial with the tool within the map
_TRIED_PAUSES_S = (2.0, 5.0, 10.0, 20.0, 40.0, 80.0)


@dataclass(frozen=True)
class Forecast:
    """Forecast of a session."""

    trials: int
    seconds: float  #: with pauses and breaks
    hottest_coil: str
    peak: float  #: winding temperature [K]
    warn: float  #: warning temperature [K]
    derate: float  #: derating temperature [K]
    pause: float | None  #: additional pause after each trial [s] that avoids derating; None: 80 s are not enough

    @property
    def holds(self) -> bool:
        """Whether the winding stays below the derating temperature."""
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
        """Summary for users."""
        c = self.peak - 273.15
        lasts = "less than a minute" if self.seconds < 60 else f"about {self.seconds / 60:.0f} min"
        begin = f"{self.trials} trials, {lasts}; hottest winding '{self.hottest_coil}' {c:.0f} °C"
        if self.holds:
            word = "stays below" if self.peak < self.warn else "warns, but stays below"
            return f"{begin}: {word} derating at {self.derate - 273.15:.0f} °C"
        cure = "longer pauses do not help: reduce the moment"
        if self.pause is not None:
            cure = f"{self.pause:g} s more pause after each trial prevent this"
        return f"{begin}: forces will be reduced (derating at {self.derate - 273.15:.0f} °C); {cure}"


@dataclass(frozen=True)
class Overlap:
    """Overlap of maps that are rendered one at a time."""

    pairs: int
    worst: float  #: [deg]
    set_points: tuple[int, int]

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {"pairs": self.pairs, "worst_deg": self.worst, "set_points": list(self.set_points)}

    @property
    def sentence(self) -> str:
        """Summary for users."""
        a, b = self.set_points
        which = f"set-points {a} and {b}" if self.pairs == 1 else f"{self.pairs} pairs of set-points"
        most = "" if self.pairs == 1 else f", {a} and {b} most,"
        return (
            f"the maps of {which} overlap{most} by {self.worst:.1f}°: render them one after the other, not several at "
            "once"
        )


@dataclass(frozen=True)
class Unfelt:
    """A condition whose world, or whose levels, cannot be felt at a set-point of its trials.

    Also a condition declared without force that renders one.
    """

    condition: str
    theta_deg: float  #: of the set-point
    parameter: str  #: varied without effect; "": the world renders nothing
    most: float  #: largest force [N] there, or torque [N·m] if only torques are rendered
    control: bool = False  #: whether it is declared without force (`no_force = true`)

    def numbers(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {
            "condition": self.condition, "theta_deg": self.theta_deg, "parameter": self.parameter or None,
            "greatest": self.most, "no_force": self.control,
        }  # fmt: skip

    @property
    def sentence(self) -> str:
        """Summary for users."""
        where = f"condition '{self.condition}', set-point at θ = {self.theta_deg:g} deg"
        if self.control:
            return (
                f"{where}: no_force = true, but the world renders up to {self.most:.3g} N (or N·m of torque) there; "
                "set its parameters so that it renders nothing, or leave out no_force"
            )
        if not self.parameter:
            return (
                f"{where}: the world renders nothing within reach of it, so there is nothing to feel; a control "
                "condition without force says no_force = true"
            )
        return (
            f"{where}: levels of '{self.parameter}' change nothing that is rendered there, so that every answer is a "
            "guess; choose a set-point within the world, or another parameter"
        )


def find_unfelt(study: Study) -> tuple[Unfelt, ...]:
    """Conditions whose world renders nothing at a set-point, or the same at every level.

    A condition with `no_force` must render nothing, and is reported where it does.
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
                if most >= _MIN_WRENCH:
                    found.append(Unfelt(condition.name, point.theta_deg, "", most, control=True))
            elif most < _MIN_WRENCH or change < _MIN_WRENCH:
                parameter = levels.parameter if levels is not None and varied else ""
                found.append(Unfelt(condition.name, point.theta_deg, parameter, most))
    return tuple(found)


def _sample_wrench(device: SphericalElectromagnet, study: Study, world: World, states: list[State]) -> Array:
    """(n, 6) rendered part of the wrench of `world` [N, N·m] at `states`."""
    part = tool_choice(device, study.render or None).choose_part(world)
    kept = np.array([part != "torque"] * 3 + [part != "force"] * 3, dtype=float)
    found: Array = np.array([world.wrench(state).copy() for state in states]).reshape(-1, 6) * kept
    return found


def _list_states(device: SphericalElectromagnet, point: SetPoint, world: World) -> list[State]:
    """Contact states within the map of `point`, evenly spaced in angle."""
    cut_off = world.cut_off_deg if isinstance(world, Dome) else 54.0
    turn, found = rotation_to_axis(point.direction), []
    for alpha in np.radians((np.arange(6) + 0.5) / 6 * cut_off):
        for phi in np.arange(6) * np.pi / 3:
            way = turn @ np.array([np.sin(alpha) * np.cos(phi), np.sin(alpha) * np.sin(phi), np.cos(alpha)])
            if np.arccos(way[2]) <= device.workspace_half_angle + np.radians(15):
                found.append(State.at(way * device.contact_distance))
    return found


def overlap(study: Study) -> Overlap | None:
    """Overlap of the domes of all set-points in the widest condition; None if there is none."""
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
    """(m,) mean square current [A²] with the tool within the map of `prompt`, in contact."""
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
    """Duration and coil temperature of the session of the `participant`-th participant (from 0)."""
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
        for more in _TRIED_PAUSES_S:
            longer = _peaks(device, loads, prompts, trials.expected_seconds, trials.pause_seconds + more)
            if longer.max() < heat.derate:
                pause = more
                break
    seconds = len(prompts) * (trials.expected_seconds + trials.pause_seconds) + sum(p.pause for p in prompts)
    return Forecast(
        len(prompts), seconds, device.coils.names[hottest], float(peaks[hottest]), heat.warn, heat.derate, pause
    )


def _list_prompts(study: Study, participant: int) -> list[Prompt]:
    """Trials in their order; an adaptive procedure at its maximum length and first level."""
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
    """(m,) peak winding temperature [K] of the session, from ambient; with temperature-dependent resistance."""
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
