"""Is a world inside what your loop can render? Its steepest places against the loop's own boundary."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from haptorb.apps.check.quick_steepness import list_quick_steepness
from haptorb.apps.check.turning import UNJUDGED, find_asked_part, steepest_turn, turning_workspace
from haptorb.apps.check.workspace import Workspace, workspace
from haptorb.apps.terminal.notebook_report import NotebookReport
from haptorb.control.stability.gradient import Steepest, Steepness, steepest
from haptorb.control.stability.hand_grip import GRIPS, HandGrip
from haptorb.control.stability.stability import SampledLoop
from haptorb.devices.device import Device
from haptorb.errors import InputError
from haptorb.runtime.tick.assembly import choice_of
from haptorb.sensing.tool.place_filter import memory
from haptorb.worlds.dynamic_world import DynamicWorld
from haptorb.worlds.world import World
from haptorb.worlds.wrench_part import WrenchPart

__all__ = ["ENOUGH", "Setting", "WorldVerdict", "judge_world"]

ENOUGH = 1.5  #: a world should be so many times weaker than the strongest that is stable: hands differ
_QUICK = 4  #: of the places where a world with memory is steepest
_FASTEST = 4000.0  #: no servo here is faster [Hz]


@dataclass(frozen=True)
class Setting:
    """How a device is run, and who holds it."""

    rate: float = 1000.0  #: of the servo [Hz]
    tracker_rate: float | None = None  #: [Hz]; None: a pose in every tick
    latency: float = 0.0  #: age of a pose when it is reported [s]
    grip: str = "light"
    hand: HandGrip = GRIPS["light"]  #: the hand alone
    bandwidth: float | None = None  #: of the filter behind field sensors, with the tracker `hall` [Hz]; None: no filter

    def loop(self, device: Device) -> SampledLoop:
        """The loop of `device` under this setting."""
        coils = device.coils
        return self.loop_with(float(np.max(coils.inductance / coils.resistance)))

    def loop_with(self, time_constant: float) -> SampledLoop:
        """The loop of coils whose L/R is `time_constant` [s]."""
        theta = 0.0 if self.bandwidth is None else memory(2 * math.pi * self.bandwidth / self.rate)
        return SampledLoop.of(self.rate, self.tracker_rate, self.latency, time_constant, theta)


@final
@dataclass(frozen=True)
class WorldVerdict(NotebookReport):
    """A world's steepest places, the loop, and the hand that holds the mover.

    margin   by how much the world could be stronger before the loop oscillates, at its most critical place
    """

    device: str
    world: str
    passive: bool
    setting: Setting
    loop: SampledLoop
    hand: HandGrip  #: with the mover in it, in the mover's own coordinates
    place: Workspace
    steep: Steepest
    part: WrenchPart | None = None  #: of the wrench that is rendered; None where there is no choice
    turning: WorldVerdict | None = None  #: on the torque, where force and torque are rendered

    printer: ClassVar[str] = "haptorb.apps.check.show_world:print_world"

    def _summarize(self) -> str:
        margin = "has no slopes" if math.isinf(self.margin) else f"could be {self.margin:.3g} times stronger"
        return f"<WorldVerdict: {self.world} on {self.device} is {self.verdict} the boundary: it {margin}>"

    @cached_property
    def margins(self) -> tuple[tuple[float, Steepness], ...]:
        """The factor to the boundary at every critical place, smallest first; those of `turning` are its own."""
        found = [(_factor(self.loop, self.hand, one), one) for one in self.steep.candidates]
        return tuple(sorted(found, key=lambda pair: pair[0]))

    @property
    def margin(self) -> float:
        """The smallest, also of the torque; inf for a world without slopes."""
        own = self.margins[0][0] if self.margins else math.inf
        return own if self.turning is None else min(own, self.turning.margin)

    @property
    def verdict(self) -> str:
        """ "inside", "close" or "outside"."""
        if self.margin >= ENOUGH:
            return "inside"
        return "close" if self.margin > 1.0 else "outside"

    @property
    def fit(self) -> bool:
        """Whether the loop is stable."""
        return self.margin > 1.0

    @property
    def unjudged(self) -> tuple[str, ...]:
        """What the analysis leaves out of this world; empty for force alone."""
        return UNJUDGED if self.part in ("torque", "both") else ()

    @cached_property
    def largest(self) -> float:
        """The largest stiffness that this loop and hand stand [N/m]; exact."""
        return self.loop.largest(self.hand)

    @cached_property
    def advice(self) -> tuple[str, ...]:
        """What to change, each by itself enough; empty for a world that is inside."""
        if self.margin >= ENOUGH:
            return ()
        if self.turning is not None and self.turning.margin <= self.margin:
            return self.turning.advice
        found = [f"Make the world {ENOUGH / self.margin:.3g} times weaker or wider (`--set`)."]
        setting = self.setting
        if setting.tracker_rate is not None:
            faster = _least(lambda x: self._compute_factor(tracker_rate=x * setting.tracker_rate), 64.0)
            if faster is not None:
                found.append(f"Use a tracker of {faster * setting.tracker_rate:.0f} Hz at the same latency.")
        if setting.latency > 0.0:
            earlier = _least(lambda x: self._compute_factor(latency=setting.latency / x), 1000.0)
            if earlier is not None:
                found.append(f"Reduce the latency to {1e3 * setting.latency / earlier:.1f} ms.")
        quicker = _least(lambda x: self._compute_factor(rate=x * setting.rate), _FASTEST / setting.rate)
        if quicker is not None:
            found.append(f"Run the servo at --rate {math.ceil(quicker * setting.rate):d}.")
        if self.margins and self.margins[0][1].damping * abs(self.loop.period) > self.hand.mass:
            found.append("The delayed damping of the world is the cause, not its stiffness: reduce the damping.")
        damper = _least(lambda x: self._compute_hand_factor(replace(self.hand, damping=x * self.hand.damping)), 100.0)
        if damper is not None and self.hand.damping > 0.0:
            found.append(
                f"Hold the tool more firmly: {damper * self.setting.hand.damping:.1f} N·s/m instead of "
                f"{self.setting.hand.damping:g} is enough; a sleeve or a glove also adds damping."
            )
        return tuple(found)

    def _compute_hand_factor(self, hand: HandGrip) -> float:
        return min((_factor(self.loop, hand, one) for _, one in self.margins), default=math.inf)

    def _compute_factor(self, **changes: float) -> float:
        setting = replace(self.setting, **changes)  # type: ignore[arg-type]
        loop = setting.loop_with(self.loop.time_constant)
        return min((_factor(loop, self.hand, one) for _, one in self.margins), default=math.inf)

    def numbers(self) -> dict[str, Any]:
        """Everything as plain JSON types; lengths are angles for a motor."""
        grip = self.hand.damping
        worst = self.margins[0][1] if self.margins else None
        return {
            "device": self.device,
            "world": self.world,
            "declared_passive": self.passive,
            "verdict": self.verdict,
            "margin": _number(self.margin),
            "unit": f"{self.place.force}/{self.place.length}",
            "force_unit": self.place.force,
            "damping_unit": f"{self.place.force}·s/{self.place.length}",
            "steepest": self.steep.stiffness,
            "pushes_away": self.steep.away,
            "damping": self.steep.damping,
            "jump_n": self.steep.jump,
            "largest_exact": _number(self.largest),
            "largest_delay_bound": self.loop.delay_bound(grip),
            "largest_passive_bound": self.loop.passive_bound(grip),
            "critical": None
            if worst is None
            else {
                "stiffness": worst.stiffness.real,
                "turning": abs(worst.stiffness.imag),
                "damping": worst.damping,
                "place": worst.place,
            },
            "rate_hz": self.setting.rate,
            "tracker_rate_hz": self.setting.tracker_rate,
            "latency_s": self.setting.latency,
            "filter_hz": self.setting.bandwidth,
            "period_s": self.loop.period,
            "lateness_s": self.loop.lateness,
            "grip": self.setting.grip,
            "hand": asdict(self.hand),
            "advice": list(self.advice),
            "part": self.part,
            "turning": None if self.turning is None else self.turning.numbers(),
            "not_judged": list(self.unjudged),
        }


def judge_world(
    device: Device, world: World, setting: Setting, name: str = "", render: str | None = None
) -> WorldVerdict:
    """Check `world` over the whole workspace of `device`; takes seconds.

    render: part of the wrench to render; None: as the world defines, see `choice_of`. Raises InputError for a
    latency above the expiry of poses, and for a part that the device cannot render.
    """
    if setting.latency > device.limits.expiry:
        raise InputError(
            f"a latency of {1e3 * setting.latency:g} ms is above {1e3 * device.limits.expiry:g} ms, the expiry of "
            f"poses on '{device.name}': the coils would stay off"
        )
    choice = choice_of(device, render)
    place, loop, called = workspace(device), setting.loop(device), name or type(world).__name__
    part = None
    if choice is not None:  # a device that can render parts is one with a tool
        part = choice.fixed or find_asked_part(device, world)

    def judge(place: Workspace, steep: Steepest, turning: WorldVerdict | None = None) -> WorldVerdict:
        hand = place.grip(setting.hand)
        return WorldVerdict(device.name, called, world.passive, setting, loop, hand, place, steep, part, turning)

    turning = None
    if part in ("torque", "both"):
        turned = turning_workspace(device)
        turning = judge(turned, steepest_turn(device, world))
    if turning is not None and part == "torque":
        return turning
    steep = steepest(place.field(world), place.places, place.inside)
    if isinstance(world, DynamicWorld):
        quick = list_quick_steepness(device, world, place, 1.0 / setting.rate)
        steep = replace(steep, candidates=(*steep.candidates, *quick[:_QUICK]))
    return judge(place, steep, turning)


def _factor(loop: SampledLoop, hand: HandGrip, one: Steepness) -> float:
    spring = one.stiffness if one.stiffness.real > 0.0 or one.stiffness.imag else 0.0  # what pushes away is no fault
    return loop.largest(hand, spring, one.damping)


def _least(margin: Any, most: float) -> float | None:
    """The least factor from 1 to `most` with which margin(factor) is enough; None if there is none."""
    if most <= 1.0 or margin(most) < ENOUGH:
        return None
    low, high = 1.0, most
    while high - low > 0.01 * high:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if margin(middle) >= ENOUGH else (middle, high)
    return high


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
