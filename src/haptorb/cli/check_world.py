"""Stability check of a world: its steepest places against the stability boundary of the loop."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import asdict, dataclass, replace
from functools import cached_property, singledispatch
from math import floor, pi
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, final

import numpy as np

from haptorb.analysis.stability import (
    GRIPS,
    MIN_STABILITY_MARGIN,
    HandGrip,
    SampledLoop,
    Steepest,
    Steepness,
    steepest,
)
from haptorb.analysis.workspace import (
    UNJUDGED,
    Workspace,
    find_asked_part,
    list_quick_steepness,
    steepest_turn,
    turning_workspace,
    workspace,
)
from haptorb.arrays import Array
from haptorb.control.registry import make_allocator, make_choice
from haptorb.devices.base import Device, State, device_function
from haptorb.devices.electromagnet import Hand, SphericalElectromagnet
from haptorb.errors import InputError
from haptorb.estimation.hall_tracker import memory
from haptorb.estimation.registry import make_estimator
from haptorb.estimation.sensor_calibration import without_errors
from haptorb.estimation.types import HandGoal, Pose
from haptorb.figure_file import show_text_as_is
from haptorb.notebook import NotebookReport
from haptorb.runtime.drivers.sim import ImperfectTracker, PoseDistortion, SimDriver
from haptorb.runtime.tick import Tick
from haptorb.simulation.electromagnet import SimulatedElectromagnet
from haptorb.terminal import Column, TextTable, make_console, print_table, print_text
from haptorb.worlds.base import World, WrenchPart, check_part
from haptorb.worlds.dynamic import DynamicWorld

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

__all__ = [
    "PoseDelay",
    "Setting",
    "WorldVerdict",
    "boundary",
    "draw_world",
    "is_growing",
    "judge_world",
    "print_world",
]


_CHECKED_PLACES = 4  #: places checked for a world with memory: the steepest
_MAX_RATE_HZ = 4000.0  #: highest servo rate [Hz]


@dataclass(frozen=True)
class Setting:
    """Loop settings of a device, and the hand that holds its mover."""

    rate: float = 1000.0  #: servo rate [Hz]
    tracker_rate: float | None = None  #: [Hz]; None: a pose in every tick
    latency: float = 0.0  #: age of a pose when it is reported [s]
    grip: str = "light"
    hand: HandGrip = GRIPS["light"]  #: impedance of the hand alone
    bandwidth: float | None = None  #: of the field sensors' filter, with the tracker `hall` [Hz]; None: no filter

    def loop(self, device: Device) -> SampledLoop:
        """Return the sampled loop of `device` under this setting."""
        coils = device.coils
        return self.loop_with(float(np.max(coils.inductance / coils.resistance)))

    def loop_with(self, time_constant: float) -> SampledLoop:
        """Return the sampled loop for coils with L/R = `time_constant` [s]."""
        theta = 0.0 if self.bandwidth is None else memory(2 * math.pi * self.bandwidth / self.rate)
        return SampledLoop.of(self.rate, self.tracker_rate, self.latency, time_constant, theta)


@final
@dataclass(frozen=True)
class WorldVerdict(NotebookReport):
    """Result of the check: steepest places of the world, loop, hand.

    margin   factor on the world's stiffness at which the loop oscillates, at its most critical place
    """

    device: str
    world: str
    passive: bool
    setting: Setting
    loop: SampledLoop
    hand: HandGrip  #: hand and mover together, in the mover's coordinates
    place: Workspace
    steep: Steepest
    part: WrenchPart | None = None  #: rendered part of the wrench; None if there is no choice
    turning: WorldVerdict | None = None  #: verdict on the torque, if force and torque are rendered

    def show(self, console: Console) -> None:
        """Print the report on `console`."""
        print_world(self, console)

    def _summarize(self) -> str:
        margin = "has no slopes" if math.isinf(self.margin) else f"could be {self.margin:.3g} times stronger"
        return f"<WorldVerdict: {self.world} on {self.device} is {self.verdict} the boundary: it {margin}>"

    @cached_property
    def margins(self) -> tuple[tuple[float, Steepness], ...]:
        """Return the factor to the boundary at each critical place, smallest first; `turning` has its own."""
        found = [(_factor(self.loop, self.hand, one), one) for one in self.steep.candidates]
        return tuple(sorted(found, key=lambda pair: pair[0]))

    @property
    def margin(self) -> float:
        """Return the smallest factor, torque included; inf for a world without stiffness."""
        own = self.margins[0][0] if self.margins else math.inf
        return own if self.turning is None else min(own, self.turning.margin)

    @property
    def verdict(self) -> str:
        """Return "inside", "close" or "outside"."""
        if self.margin >= MIN_STABILITY_MARGIN:
            return "inside"
        return "close" if self.margin > 1.0 else "outside"

    @property
    def fit(self) -> bool:
        """Whether the loop is stable."""
        return self.margin > 1.0

    @property
    def unjudged(self) -> tuple[str, ...]:
        """List the properties of this world that the analysis leaves out; empty for force alone."""
        return UNJUDGED if self.part in ("torque", "both") else ()

    @cached_property
    def largest(self) -> float:
        """Return the largest stable stiffness for this loop and hand [N/m]; exact."""
        return self.loop.largest(self.hand)

    @cached_property
    def advice(self) -> tuple[str, ...]:
        """Return recommendations, each sufficient by itself; empty for a world inside the boundary."""
        if self.margin >= MIN_STABILITY_MARGIN:
            return ()
        if self.turning is not None and self.turning.margin <= self.margin:
            return self.turning.advice
        if self.margin == 0.0:  # without damping in the hand no stiffness is stable
            return ()
        found = [f"Make the world {MIN_STABILITY_MARGIN / self.margin:.3g} times weaker or wider (`--set`)."]
        setting = self.setting
        if setting.tracker_rate is not None:
            faster = _least(lambda x: self._compute_factor(tracker_rate=x * setting.tracker_rate), 64.0)
            if faster is not None:
                found.append(f"Use a tracker of {faster * setting.tracker_rate:.0f} Hz at the same latency.")
        if setting.latency > 0.0:
            earlier = _least(lambda x: self._compute_factor(latency=setting.latency / x), 1000.0)
            if earlier is not None:
                found.append(f"Reduce the latency to {1e3 * setting.latency / earlier:.1f} ms.")
        quicker = _least(lambda x: self._compute_factor(rate=x * setting.rate), _MAX_RATE_HZ / setting.rate)
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
        """Return everything as plain JSON types; lengths are angles for a motor."""
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

    render: part of the wrench to render; None: as the world defines, see `make_choice`. Raises InputError for a
    latency above the expiry of poses, and for a part that the device cannot render.
    """
    if setting.latency > device.limits.expiry:
        raise InputError(
            f"a latency of {1e3 * setting.latency:g} ms is above {1e3 * device.limits.expiry:g} ms, the expiry of "
            f"poses on '{device.name}': the coils would stay off"
        )
    choice = make_choice(device, None if render is None else check_part(render))
    place, loop, called = workspace(device), setting.loop(device), name or type(world).__name__
    part = None
    if choice is not None:  # only devices with a tool have a choice of the part
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
        steep = replace(steep, candidates=(*steep.candidates, *quick[:_CHECKED_PLACES]))
    return judge(place, steep, turning)


def _factor(loop: SampledLoop, hand: HandGrip, one: Steepness) -> float:
    spring = one.stiffness if one.stiffness.real > 0.0 or one.stiffness.imag else 0.0  # a negative one is no fault
    return loop.largest(hand, spring, one.damping)


def _least(margin: Any, most: float) -> float | None:
    """Return the smallest factor from 1 to `most` for which margin(factor) is sufficient; None if there is none."""
    if most <= 1.0 or margin(most) < MIN_STABILITY_MARGIN:
        return None
    low, high = 1.0, most
    while high - low > 0.01 * high:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if margin(middle) >= MIN_STABILITY_MARGIN else (middle, high)
    return high


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


# --------------------------------------------------------------------------------------------------
# Report on the terminal and plot of the Z-width.


#: verdict → text and colour
_VERDICT_STYLES = {
    "inside": ("Inside", "green"),
    "close": ("Close to the limit", "yellow"),
    "outside": ("Outside", "red"),
}


def print_world(verdict: WorldVerdict, console: Console | None = None) -> None:
    """Print the stiffness of the world, the limit of the loop, and advice."""
    console = console or make_console()
    setting, loop, steep = verdict.setting, verdict.loop, verdict.steep
    unit = f"{verdict.place.force}/{verdict.place.length}"
    tracker = "a pose in every tick" if setting.tracker_rate is None else f"tracker {setting.tracker_rate:g} Hz"
    if setting.bandwidth is not None:
        tracker = f"field sensors, filtered to {setting.bandwidth:g} Hz"
    print_text(
        console,
        f"{verdict.device}, world '{verdict.world}': servo {setting.rate:g} Hz, {tracker}, "
        f"latency {1e3 * setting.latency:g} ms; grip {setting.grip} ({setting.hand.mass:g} kg, "
        f"{setting.hand.damping:g} N·s/m, {setting.hand.stiffness:g} N/m)",
    )
    print_text(
        console,
        f"each force is held for {1e3 * loop.period:.2f} ms and is {1e3 * loop.lateness:.2f} ms late, current rise "
        "included\n",
        "dim",
    )
    table = TextTable((Column("stiffness", kind="text"), Column("", unit)))
    b = verdict.hand.damping
    table.add_row("largest stiffness of this world", f"{steep.stiffness:.4g}")
    table.add_row("largest stable with this hand: exact", _value(verdict.largest))
    table.add_row("largest stable by b/(T/2 + t_d)", f"{loop.delay_bound(b):.4g}")
    table.add_row("passive with any hand, without latency: 2b/T", f"{loop.passive_bound(b):.4g}")
    if steep.away > 0.0:
        table.add_row("largest negative (the tool slips off; no fault)", f"{steep.away:.4g}")
    print_table(console, table)
    print_text(console)
    if verdict.turning is not None:
        _print_turning(verdict.turning, console)
    if steep.damping > 0.0:
        damper = f"{verdict.place.force}·s/{verdict.place.length}"
        print_text(console, f"damping of the world: up to {steep.damping:.3g} {damper}")
    if steep.jump > 0.0:
        print_text(
            console,
            f"The force jumps by up to {1e3 * steep.jump:.0f} m{verdict.place.force}: a jump has no slope and no "
            "margin; a hand at rest on the edge may feel chatter.",
        )
    if not verdict.passive:
        print_text(
            console, "Declared active: it may produce energy by design, so the passivity control only monitors it."
        )
    for left_out in verdict.unjudged:
        print_text(console, f"Not judged: {left_out}.")
    margin = "nothing can oscillate" if math.isinf(verdict.margin) else _margin(verdict.margin)
    words, colour = _VERDICT_STYLES[verdict.verdict]
    print_text(console, f"{words}: {margin}.", f"bold {colour}")
    for advice in verdict.advice:
        print_text(console, f"• {advice}", indent="  ")


def _print_turning(verdict: WorldVerdict, console: Console) -> None:
    table = TextTable((Column("stiffness of the torque", kind="text"), Column("", "N·m/rad")))
    table.add_row("largest stiffness of this world", f"{verdict.steep.stiffness:.4g}")
    table.add_row("largest stable with this hand: exact", _value(verdict.largest))
    print_table(console, table)
    print_text(console)


def _margin(margin: float) -> str:
    if margin == 0.0:
        return (
            "in this hand no stiffness at all is stable, as it takes no energy: hold the tool, or check another --grip"
        )
    if margin > 1.0:
        return f"the world could be {margin:.3g} times as strong before it oscillates"
    return f"it is {1 / margin:.3g} times too strong and will oscillate"


def _value(value: float) -> str:
    return "no limit" if math.isinf(value) else f"{value:.4g}"


def draw_world(
    verdict: WorldVerdict, path: Path, tried: Sequence[tuple[float, float]] = (), ages: Sequence[float] = ()
) -> Path:
    """Draw the Z-width into `path`: over the hand's damping, and over the age of poses.

    tried: pairs of damping [N·s/m] and the largest stiffness of the simulated chain; ages [s] for the right panel.
    """
    from dataclasses import replace

    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from haptorb.analysis.stability import SampledLoop

    loop, hand, setting = verdict.loop, verdict.hand, verdict.setting
    unit = f"{verdict.place.force}/{verdict.place.length}"
    damper = f"{verdict.place.force}·s/{verdict.place.length}"
    scale = hand.damping / setting.hand.damping if setting.hand.damping else 1.0
    figure = Figure(figsize=(12, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    b = np.geomspace(0.3, 30, 31) * scale
    exact = [loop.largest(replace(hand, damping=float(one))) for one in b]
    left.fill_between(b, 1e-9, exact, color="C2", alpha=0.12, lw=0)
    left.loglog(b, exact, "C2-", lw=2, label="stable with this hand, exact")
    left.loglog(b, [loop.delay_bound(one) for one in b], "k--", lw=1, label="b/(T/2 + t_d)")
    left.loglog(b, [loop.passive_bound(one) for one in b], "k:", lw=1, label="passive without latency: 2b/T")
    if tried:
        left.plot(*np.array(tried).T, "C3o", label="simulated chain")
    if verdict.steep.stiffness > 0.0:
        left.plot([hand.damping], [verdict.steep.stiffness], "C0D", ms=8, label=f"world '{verdict.world}', this grip")
    left.set(xlabel=f"damping of the hand [{damper}]", ylabel=f"largest stiffness [{unit}]", xlim=(b[0], b[-1]))
    low = min([exact[0], *([verdict.steep.stiffness] if verdict.steep.stiffness > 0 else [])])
    left.set_ylim(0.4 * low, 3 * max(loop.passive_bound(b[-1]), exact[-1]))
    left.set_title("Largest stiffness that this loop can render", loc="left")
    left.legend(frameon=False, fontsize=8)
    left.grid(alpha=0.3, which="both")
    age = np.linspace(0, 0.03, 31)
    for rate, colour in ((60.0, "C4"), (120.0, "C1"), (240.0, "C0"), (setting.rate, "C2")):
        bounds = [
            SampledLoop.of(setting.rate, rate if rate != setting.rate else None, one, loop.time_constant).largest(hand)
            for one in age.tolist()
        ]
        right.semilogy(1e3 * age, bounds, colour, label=f"{rate:g} Hz")
    if verdict.steep.stiffness > 0.0:
        right.axhline(verdict.steep.stiffness, color="C0", ls=":", lw=1)
        right.annotate(f"'{verdict.world}'", (30, verdict.steep.stiffness), (-2, 3), textcoords="offset points",
                       ha="right")  # fmt: skip
    right.plot([1e3 * setting.latency], [verdict.largest], "kx", ms=9, mew=2, label="your setting")
    right.set(xlabel="latency of a pose [ms]", ylabel=f"largest stiffness [{unit}]", xlim=(0, 30))
    right.set_title(f"Effect of the tracker's rate and latency, grip {setting.grip}", loc="left")
    right.legend(frameon=False, fontsize=8, title="poses")
    right.grid(alpha=0.3, which="both")
    show_text_as_is(figure).savefig(path, dpi=120)
    return path


# --------------------------------------------------------------------------------------------------
# Tracker with a limited rate and a latency.


@final
class PoseDelay(PoseDistortion):
    """Pose at a limited rate, 1/`rate` [s] apart, each reported `latency` [s] late.

    Between two poses the last one is extrapolated with its velocity; the reported velocity is the difference quotient
    of the last two poses, as from a tracker that measures positions. rate None: a pose in every tick.
    """

    def __init__(self, rate: float | None, latency: float) -> None:
        self._period, self._latency = None if rate is None else 1 / rate, latency
        self._history: deque[tuple[float, Pose]] = deque(maxlen=4096)
        self.reset()

    def reset(self) -> None:
        """Discard all stored poses."""
        self._history.clear()
        self._last: Pose | None = None

    def distort(self, now: float, pose: Pose) -> Pose:
        """Return the pose that a tracker with this latency would have reported by `now` [s]."""
        self._history.append((now, pose))
        at = now - self._latency
        if self._period is not None:
            at = floor(at / self._period + 1e-9) * self._period
        if self._last is None:
            self._last = replace(pose, t=now, v=np.zeros(3))
        elif at > self._last.t + 1e-9:
            p, R = self._pose_at(at)
            self._last = Pose(at, R, p, pose.w, (p - self._last.p) / (at - self._last.t), True)
        return self._last

    def _pose_at(self, at: float) -> tuple[Array, Array]:
        for then, pose in reversed(self._history):
            if then <= at + 1e-9:
                return pose.p + (at - then) * pose.v, pose.R_SR
        pose = self._history[0][1]
        return pose.p, pose.R_SR


# --------------------------------------------------------------------------------------------------
# Stability boundary by simulation: springs of growing stiffness in the closed loop, excited by one push.
#
# The whole loop is simulated: estimator, allocator, guard, drive, coils with inductance, exact wrench of the magnets,
# a tool in a hand; only the tracker is given rate and latency. Linear as long as no limit is reached.


_SPRING_HEIGHT_M = 0.010  #: height of the spring's centre above contact: clear of the dome [m]
_RAMP_END_S = 0.45  #: time at which the guard's ramp is complete [s]
_PUSH_FORCE_N = 0.02  #: force with which the hand leans on its own spring [N]
_WINDOW_CYCLES = 5  #: cycles in each of two windows whose amplitudes are compared
_SIMULATION_STEP_S = 1e-4  #: simulation step [s]


@dataclass(frozen=True)
class _Spring(World):
    """Linear spring to a plane normal to x: the simplest world that can oscillate.

    Declared active, so that the passivity control does not damp it.
    """

    passive: ClassVar[bool] = False

    stiffness: float = 0.0  #: [N/m]

    def wrench(self, state: State) -> Array:
        """Return the spring's wrench (6,) [N, N·m]."""
        wrench = np.zeros(6)
        wrench[0] = -self.stiffness * state.p[0]
        return wrench


def is_growing(
    device: SphericalElectromagnet, grip: HandGrip, stiffness: float, rate: float, tracker_rate: float | None,
    latency: float, *, hall: bool = False,
) -> bool:  # fmt: skip
    """Return whether an oscillation of the tool across a spring of `stiffness` [N/m] grows; `grip` is the hand alone.

    hall: the pose comes from the field sensors, calibrated and without noise (noise excites the tool, but does not
    affect stability).
    """
    held = replace(
        device,
        hand=Hand(grip.mass, grip.damping, grip.stiffness, device.hand.turn_damping, device.hand.turn_stiffness),
    )
    if hall:
        held = without_errors(held)
        held = replace(
            held,
            hall=replace(held.hall, noise=0.0, step=0.0),
            supply=replace(held.supply, current_noise=0.0, current_step=0.0),
        )
    middle = np.array([0.0, 0.0, device.contact_distance + _SPRING_HEIGHT_M])
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    lean = np.array([_PUSH_FORCE_N / max(grip.stiffness, 1.0), 0.0, 0.0])
    pushed_for = 0.25 * 2 * pi * ((grip.mass + device.tool.mass) / (stiffness + grip.stiffness)) ** 0.5

    def goal(now: float) -> HandGoal:
        pushed = _RAMP_END_S <= now < _RAMP_END_S + pushed_for
        return HandGoal(middle + lean if pushed else middle, upright, now, False)

    dt = 1 / rate
    inner = SimDriver(SimulatedElectromagnet(held, step=_SIMULATION_STEP_S), dt, goal)
    driver = inner if hall else ImperfectTracker(inner, PoseDelay(tracker_rate, latency))
    estimator = make_estimator(held, "hall" if hall else "tracker", None)
    tick = Tick(held, _Spring(stiffness), driver, estimator, make_allocator(held), dt)
    row = tick.layout.empty()
    window = _WINDOW_CYCLES * 4 * pushed_for
    start = _RAMP_END_S + pushed_for + 0.25 * window
    places: list[float] = []
    with driver:
        for n in range(round((start + 2 * window) * rate)):
            tick.step(row, n * dt)
            if n * dt >= start:
                places.append(float(inner.simulation.state().p[0]))
    half = len(places) // 2
    early, late = (np.std(part) for part in (places[:half], places[half:]))
    return bool(late > early)


@device_function
@singledispatch
def boundary(
    device: Device, grip: HandGrip, expected: float, rate: float, tracker_rate: float | None = None,
    latency: float = 0.0, precision: float = 0.02, *, hall: bool = False,
) -> float | None:  # fmt: skip
    """Find the largest stable stiffness of the simulated closed loop by bisection, by the kind of device.

    Parameters
    ----------
    device : Device
        The device.
    grip : HandGrip
        Impedance of the hand.
    expected : float
        Stiffness at which the search starts [N/m].
    rate : float
        Rate of the loop [Hz].
    tracker_rate : float, optional
        Rate of the tracker [Hz]; None: that of the loop.
    latency : float
        Age of a pose when it arrives [s].
    precision : float
        Relative width of the interval at which the search ends [1].
    hall : bool
        Whether the pose is estimated from Hall sensors.

    Returns
    -------
    float or None
        Stiffness [N/m]; None for a kind whose loop cannot be simulated with a spring.
    """
    return None


@boundary.register(SphericalElectromagnet)
def _(
    device: SphericalElectromagnet, grip: HandGrip, expected: float, rate: float, tracker_rate: float | None = None,
    latency: float = 0.0, precision: float = 0.02, *, hall: bool = False,
) -> float:  # fmt: skip
    low, high = 0.7 * expected, 1.4 * expected
    while is_growing(device, grip, low, rate, tracker_rate, latency, hall=hall):
        low, high = 0.5 * low, low
        if low < 1e-3 * expected:
            return 0.0
    while not is_growing(device, grip, high, rate, tracker_rate, latency, hall=hall):
        low, high = high, 2 * high
        if high > 1e3 * expected:
            return float("inf")
    while high - low > precision * high:
        middle = 0.5 * (low + high)
        if is_growing(device, grip, middle, rate, tracker_rate, latency, hall=hall):
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)
