"""Simulated participant: sensorimotor model that answers prompts from the forces that the device delivers.

To find a summit, the model sweeps the dome, then probes near the best place. A probe is a perceived force: with errors
of magnitude and direction, and a fraction of the pen's weight that is not compensated. Its tilt, with the map known,
gives an estimate of the summit's distance and direction. Later probes have more weight. The place is then recalled,
approached and reported; recall errors are small at the top, which is a landmark, larger elsewhere, and vary between
trials.

CALIBRATED, not predicted: `recall`, `recall_reach_deg`, `recall_spread`, `gravity_left`, `probes`, `forgetting` and
`motor_noise` were chosen once so that 6 participants × 50 trials give the errors that Zárate 2020 measured (2.5, 5.7,
6.5, 7.2 mm at θ = 0, 18, 36, 54 deg), on layout 1-8-8-8. With them 48 participants of 8 seeds give 2.3, 5.6, 6.4 and
6.8 mm (standard deviations 1.3, 4.3, 4.7 and 5.0; the paper's are 1.4, 4.6, 5.2 and 5.1). Single groups of six scatter
about that: about half of the seeds are within one standard error at all four angles, among them the default 0. The
just-noticeable differences are from the literature. The model can predict how many participants a study needs, or which
of two designs is likely localised more exactly; it cannot confirm the paper.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from haptorb.arrays import Array
from haptorb.control.allocation import tool_choice
from haptorb.devices.base import State
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.simulation.tool_dynamics import GRAVITY
from haptorb.worlds.base import World, WrenchPart
from haptorb.worlds.dome import Dome
from haptorb_study.prompts import Answer, Prompt
from haptorb_study.set_points import directions, nearest
from haptorb_study.study_file import Study

__all__ = ["DeliveredForce", "Participant", "Traits"]


# --------------------------------------------------------------------------------------------------
# Delivered force: commanded through the controller's model, evaluated with the exact device.


@final
class DeliveredForce:
    """Force on a radial tool, with current limits and model errors; static, at ambient temperature.

    As `haptorb.force_map`, but a vector, for one place.
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


_SIGMA_PER_JND = 1 / (0.6745 * 2**0.5)  # JND (75 % of the pairs) to the SD of a single sensation


@dataclass(frozen=True)
class Traits:
    """Sensorimotor parameters of a person; the defaults are typical."""

    force_jnd: float = 0.085  #: relative; middle of 7 to 10 %
    direction_jnd_deg: float = 22.0  #: within 18 to 32 deg
    detection: float = 0.03  #: [N] detection threshold; assumed
    gravity_left: float = 0.45  #: mean fraction of the pen's weight that is attributed to the dome; calibrated
    motor_noise: float = 1.0e-3  #: [m] SD of a placed pen per direction; calibrated
    tremor: float = 0.15e-3  #: [m] per direction; assumed
    probes: int = 14  #: forces compared near the best place; calibrated
    forgetting: float = 0.16  #: minimum weight of the newest probe; calibrated
    recall: float = 3.5e-3  #: typical SD of recalled places away from the top [m] per direction; calibrated
    recall_reach_deg: float = 9.5  #: angle over which the top serves as a landmark; calibrated
    recall_spread: float = 0.6  #: SD of the logarithm of a trial's recall error; calibrated
    lapse: float = 0.01  #: share of forced choices answered without attention; assumed
    force_exponent: float = 0.8  #: of estimated over true magnitude; assumed
    between: float = 0.12  #: SD between persons of the logarithm of the parameters above

    def draw_person(self, draw: np.random.Generator) -> Traits:
        """Draw one person at random."""
        names = ("force_jnd", "direction_jnd_deg", "gravity_left", "motor_noise", "tremor", "recall")
        factors = np.exp(self.between * draw.standard_normal(len(names)))
        return replace(self, **{n: getattr(self, n) * float(f) for n, f in zip(names, factors, strict=True)})


@final
class Participant:
    """Answers the prompts of one study; deterministic for seed and trial number."""

    def __init__(self, study: Study, seed: tuple[int, ...], traits: Traits | None = None) -> None:
        self._study, self._seed = study, seed
        self._device: SphericalElectromagnet = study.load_device()
        self.traits = (traits or Traits()).draw_person(np.random.default_rng([*seed, 0]))
        self._felt: dict[tuple[str, int, float], DeliveredForce] = {}
        self._ways = directions(study.points)
        self._coarse: dict[tuple[str, int, float], Array] = {}

    def answer(self, prompt: Prompt, number: int) -> Answer:
        """Answer trial `number` from a random stream of its own, so that a resumed session continues identically."""
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
        """(3,) position of the tool's magnet at the answer [m]."""
        traits, contact = self.traits, self._device.contact_distance
        sharpness = self._sharpness(prompt)
        guess = self._ways[
            int(np.argmax(self._sweep_dome(prompt) * (1 + self._noise * draw.standard_normal(len(self._ways)))))
        ]
        # The uncompensated fraction of the pen's weight varies between trials, with an SD equal to its mean.
        left = traits.gravity_left * (1 + float(draw.standard_normal()))
        weight = left * self._device.tool.mass * GRAVITY
        for n in range(traits.probes):
            at = _move_on_sphere(guess, np.radians(4.0) * draw.standard_normal(2))
            felt = self._sense_force(prompt, at, weight, draw)
            away, out = felt - (felt @ at) * at, float(felt @ at)
            sideways = float(np.linalg.norm(away))
            if np.hypot(sideways, out) < traits.detection:
                continue
            # The force tilts outwards with the distance of the summit: tan kα = 2 F_t / F_r.
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
        return self.traits.force_jnd * _SIGMA_PER_JND

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
        """(n,) radial force [N] at every set-point, as in a sweep over the dome."""
        key = (prompt.condition, prompt.set_point, prompt.level)
        if key not in self._coarse:
            felt = self._force_model(prompt)
            self._coarse[key] = np.array([felt.force(way) @ way for way in self._ways])
        return self._coarse[key]

    def _sense_force(self, prompt: Prompt, at: Array, weight: float, draw: np.random.Generator) -> Array:
        """(3,) perceived force [N] at `at`, a unit vector, with the pen's weight `weight` [N] attributed to it."""
        traits = self.traits
        force: Array = self._force_model(prompt).force(at) - np.array([0.0, 0.0, weight])
        size = float(np.linalg.norm(force))
        if size < 1e-9:
            return force
        tilt = np.radians(traits.direction_jnd_deg) * _SIGMA_PER_JND * draw.standard_normal(2)
        felt: Array = size * (1 + self._noise * float(draw.standard_normal())) * _move_on_sphere(force / size, tilt)
        return felt

    def _compare_intervals(self, prompt: Prompt, draw: np.random.Generator) -> int:
        """Interval, 1 or 2, perceived as stronger."""
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
        """Rating that grows with the force up to 1 N, the only preference of a simulated participant."""
        liking = min(1.0, self._strength(prompt)) + 0.1 * float(draw.standard_normal())
        return int(np.clip(round(prompt.low + liking * (prompt.high - prompt.low)), prompt.low, prompt.high))

    def _estimate(self, prompt: Prompt, draw: np.random.Generator) -> float:
        """Magnitude estimate by a power law (Stevens 1957), on a personal scale of about 100 for 1 N.

        Rounded to two digits, as most participants answer.
        """
        scale = 100.0 * float(np.exp(0.5 * np.random.default_rng([*self._seed, 2]).standard_normal()))
        felt = max(1e-3, self._strength(prompt) * (1 + self._noise * float(draw.standard_normal())))
        estimate = min(float(f"{scale * felt**self.traits.force_exponent:.2g}"), float(prompt.high))
        return estimate if prompt.decimal else max(prompt.low, round(estimate))


def _move_on_sphere(way: Array, step: Array) -> Array:
    """`way` (3,), a unit vector, moved on the sphere by `step` (2,) [rad]."""
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
    """`way`, limited to the polar angle `limit` [rad]."""
    if way[2] >= np.cos(limit):
        return way
    round_ = np.array([way[0], way[1], 0.0])
    round_ /= max(float(np.linalg.norm(round_)), 1e-12)
    rim: Array = np.sin(limit) * round_ + np.array([0.0, 0.0, np.cos(limit)])
    return rim
