"""Virtual coupling of a scene: the largest stiffness that loop, hand and coupled body allow.

The hand feels the coupling, whatever the scene does behind it; in the worst case the scene does not yield. So the
coupling is treated as a spring and a damper against a wall, and `SampledLoop` gives their exact stability limit, from
which they have a margin of `MIN_STABILITY_MARGIN`. The coupled body must be stable too: its time step is explicit, so
the damper dissipates at most the share `_SLOW` of its momentum in one step of the scene. While the scene runs in slow
time, the damper may increase (`haptorb.worlds.scene_physics`), within the limits of the same loop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache, singledispatch

import numpy as np

from haptorb.analysis.stability import GRIPS, MIN_STABILITY_MARGIN, HandGrip, SampledLoop
from haptorb.control.linkage import MOTOR_GAINS
from haptorb.devices.api import electromagnet
from haptorb.devices.arm import Arm
from haptorb.devices.base import Device, device_function
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.motor import SphericalMotor
from haptorb.display import format_number
from haptorb.errors import InputError
from haptorb.estimation.hall_tracker import HallTracker, memory
from haptorb.worlds.base import Sum, World
from haptorb.worlds.scene import Scene

__all__ = [
    "DEFAULT_LATENCY_S",
    "Coupling",
    "CouplingSetting",
    "HeldMover",
    "choose_coupling",
    "couple_world",
    "describe_coupling",
    "hold_arm",
    "hold_mover",
    "hold_rotor",
    "hold_tool",
]


# --------------------------------------------------------------------------------------------------
# Hand on a device's mover, as seen by a scene's coupling: one record for each kind of device.


@dataclass(frozen=True)
class HeldMover:
    """Hand and mover combined.

    Parameters
    ----------
    grip : HandGrip
        Impedance in the coordinates of the loop: of a rotor, about its centre, in [kg·m², N·m·s, N·m].
    move : float
        Factor from a stiffness along the axes of a scene to these coordinates [1 for a tool, m² for a rotor].
    turn : float
        Factor from a stiffness about the axes of a scene to these coordinates [1/m² for a tool, 1 for a rotor]; 0: no
        torque is rendered.
    strongest : float
        Maximum force of the device on the mover, for the minimum displacement [N]; inf: no limit.
    """

    grip: HandGrip
    move: float = 1.0
    turn: float = 0.0
    strongest: float = math.inf


@device_function
@singledispatch
def hold_mover(device: Device, hand: HandGrip) -> HeldMover:
    """Combine a hand and the mover that it holds, by the kind of device; a scene needs it.

    Parameters
    ----------
    device : Device
        The device.
    hand : HandGrip
        Impedance of the hand.

    Returns
    -------
    HeldMover
        Hand and mover combined.

    Raises
    ------
    InputError
        For a kind that cannot be coupled to a scene.
    """
    raise InputError(f"device '{device.name}' ({device.kind.title}) has neither a tool nor a rotor for a scene")


@hold_mover.register(CoilArray)
@hold_mover.register(SphericalElectromagnet)
def hold_tool(device: SphericalElectromagnet | CoilArray, hand: HandGrip) -> HeldMover:
    """Combine `hand` and a tool that renders forces."""
    return HeldMover(hand.with_mass(device.tool.mass), strongest=device.limits.force)


@hold_mover.register(Arm)
def hold_arm(device: Arm, hand: HandGrip) -> HeldMover:
    """Combine `hand` and an arm's end effector; with an actuated orientation, at the lever arm of the fingers."""
    square = device.turning_arm**2
    held = hand.with_mass(device.effector.mass)
    turn = device.effector.mass * square / device.effector.inertia if square else 0.0
    return HeldMover(held, turn=turn, strongest=device.limits.force)


@hold_mover.register(SphericalMotor)
def hold_rotor(device: SphericalMotor, hand: HandGrip) -> HeldMover:
    """Combine `hand` and a handle that moves an object in both modes by the default gains."""
    arm, gains = device.rotor.handle_length, MOTOR_GAINS
    inertia = float(device.rotor.inertia[0]) + hand.mass * arm**2
    grip = HandGrip(inertia, hand.damping * arm**2, hand.stiffness * arm**2)
    rendered = np.array([*gains.translate, *gains.rotate]) ** 2 * gains.torque_per_motion
    return HeldMover(grip, float(rendered[:3].max()), float(rendered[3:].max()))


DEFAULT_LATENCY_S = 5e-3  #: default latency of a tracker in a process of its own [s]
_SLOW = 0.3  #: share of a body's momentum that the damper dissipates in one step of the scene
_RATIOS = (0.7, 0.4)  #: damping ratios of the body in the coupling, the larger first
_MIN_STIFFNESS_RATIO = 0.8  #: a larger damping ratio is preferred down to this share of the stiffness
_MAX_DAMPING_GROWTH = 2.0  #: of the damper in slow time: above it, the hand would feel each lost contact as an impact
_SOFT = 1e-3
#: displacement within which a tool reaches its maximum force: a smaller one would feel like a switch [m]
_MIN_SATURATION_DISTANCE_M = 2e-3
_MAX_INERTIA = (0.2, 2e-4)  #: limits on the effective inertia of a body [kg], [kg·m²]
_MAX_STIFFNESS, _MAX_TURN_STIFFNESS = 5e3, 20.0  #: limits on the stiffness of a scene's contacts [N/m], [N·m/rad]


@dataclass(frozen=True)
class Coupling:
    """Stiffness [N/m] and damping [N·s/m] along each axis, and about it [N·m/rad], [N·m·s/rad]; 0: none.

    margin   factor on both at which the loop would oscillate against a wall
    limit    cause of the limit on the stiffness: "loop" or "body"
    """

    stiffness: float
    damping: float
    turn_stiffness: float
    turn_damping: float
    margin: float
    limit: str


def choose_coupling(scene: Scene, device: Device, loop: SampledLoop, hand: HandGrip) -> Coupling:
    """Coupling of `scene` on `device` in a loop, for `hand` alone; the mover is added here.

    Raises InputError for a kind of device with neither tool nor rotor.
    """
    # A body that cannot rotate, or only with others, is no reason for a very large damper.
    mass, inertia = (min(one, most) for one, most in zip(scene.effective_inertia, _MAX_INERTIA, strict=True))
    step = scene.model.model.opt.timestep
    held, square = hold_mover(device, hand), scene.scale**2
    stiffest = min(_MAX_STIFFNESS, held.strongest / (_MIN_SATURATION_DISTANCE_M * square))
    move = _choose(loop, held.grip, held.move * square, mass, float(step), stiffest)
    if not held.turn:
        return Coupling(*move[:2], 0.0, 0.0, *move[2:])
    turn = _choose(loop, held.grip, held.turn, inertia, float(step), _MAX_TURN_STIFFNESS)
    return Coupling(*move[:2], *turn[:2], min(move[2], turn[2]), move[3])


def couple_world(world: World, device: Device, loop: SampledLoop, hand: HandGrip = GRIPS["light"]) -> World:
    """Return `world` with the coupling of every scene whose stiffness is 0, and the dampers for slow time; other worlds
    are unchanged."""
    if isinstance(world, Sum):
        return replace(world, parts=tuple(couple_world(part, device, loop, hand) for part in world.parts))
    if not isinstance(world, Scene):
        return world
    if not world.stiffness:
        found = choose_coupling(world, device, loop, hand)
        world = world.replace(
            stiffness=_round(found.stiffness), damping=_round(found.damping),
            turn_stiffness=_round(found.turn_stiffness), turn_damping=_round(found.turn_damping),
        )  # fmt: skip
    fitted, held = world.for_device(device), hold_mover(device, hand)
    turned = (held.turn, fitted.turn_stiffness, fitted.turn_damping)
    moved = (held.move * world.scale**2, fitted.stiffness, fitted.damping)
    return world.replace(
        slow_damping=world.slow_damping or _round(_find_slow_damping(loop, held.grip, *moved)),
        slow_turn_damping=world.slow_turn_damping or _round(_find_slow_damping(loop, held.grip, *turned)),
    )


@lru_cache(maxsize=64)
def _find_slow_damping(loop: SampledLoop, hand: HandGrip, square: float, stiffness: float, damping: float) -> float:
    """Maximum damping of the coupling in slow time, at the required stability margin."""
    if not (square and stiffness and damping):
        return 0.0

    def margin(factor: float) -> float:
        return loop.largest(hand, square * stiffness, square * factor * damping)

    low, high = 1.0, _MAX_DAMPING_GROWTH
    enough = min(MIN_STABILITY_MARGIN, margin(low))
    if margin(high) >= enough:
        return high * damping
    while high > 1.01 * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if margin(middle) >= enough else (low, middle)
    return low * damping


def describe_coupling(scene: Scene, device: Device, loop: SampledLoop, hand: HandGrip) -> str:
    """One line: coupling of mover and body, with its stability margin."""
    fitted = scene.for_device(device)
    text = f"body '{scene.body}' held by {fitted.stiffness:.4g} N/m and {fitted.damping:.3g} N·s/m"
    if fitted.turn_stiffness:
        text += f", {fitted.turn_stiffness:.3g} N·m/rad and {fitted.turn_damping:.2g} N·m·s/rad"
    margin = measure_margin(fitted, device, loop, hand)
    late = 1e3 * loop.lateness
    return (
        f"{text}; the loop is stable up to {format_number(margin)} times this stiffness "
        f"(poses every {1e3 * loop.period:.3g} ms, forces {late:.3g} ms late, "
        f"hand of {hand.mass:g} kg, {hand.damping:g} N·s/m, {hand.stiffness:g} N/m)"
    )


def measure_margin(scene: Scene, device: Device, loop: SampledLoop, hand: HandGrip) -> float:
    """Stability margin of the coupling of `scene` against a wall, as a factor on its stiffness; 1: boundary."""
    held = hold_mover(device, hand)
    square = held.move * scene.scale**2
    moving = loop.largest(held.grip, square * scene.stiffness, square * scene.damping)
    if not held.turn:
        return moving
    return min(moving, loop.largest(held.grip, held.turn * scene.turn_stiffness, held.turn * scene.turn_damping))


@dataclass(frozen=True)
class CouplingSetting:
    """Operating conditions of `device`: `rate` [Hz], grip `hand`, pose from `estimator`.

    fed      poses come from a tracker with a process of its own
    latency  of that tracker [s]; None: `DEFAULT_LATENCY_S`
    """

    device: Device
    rate: float
    hand: HandGrip
    estimator: str = "tracker"
    fed: bool = False
    latency: float | None = None

    def __post_init__(self) -> None:
        if self.latency is not None and not (math.isfinite(self.latency) and 0.0 <= self.latency <= self._expiry):
            raise InputError(
                f"latency must be at least 0 and at most {1e3 * self._expiry:g} ms, the expiry of poses on "
                f"'{self.device.name}'; got {1e3 * self.latency:g} ms"
            )

    @property
    def _expiry(self) -> float:
        return float(self.device.limits.expiry)

    @property
    def loop(self) -> SampledLoop:
        """Timing of the loop for which a coupling is chosen."""
        coils = self.device.coils
        late = self.latency if self.latency is not None else (DEFAULT_LATENCY_S if self.fed else 0.0)
        theta = 0.0
        if self.estimator == "hall":
            theta = memory(2 * math.pi * HallTracker(electromagnet(self.device)).bandwidth / self.rate)
        return SampledLoop.of(self.rate, None, late, float(np.max(coils.inductance / coils.resistance)), theta)

    def couple(self, world: World) -> World:
        """Return `world` with the coupling of its scenes where it is not set; other worlds are unchanged."""
        return couple_world(world, self.device, self.loop, self.hand) if _has_scene(world) else world

    def describe(self, world: World) -> str:
        """Coupling of the mover to each scene of `world`; empty without one."""
        parts = world.parts if isinstance(world, Sum) else (world,)
        scenes = [one for one in parts if isinstance(one, Scene)]
        return "; ".join(describe_coupling(one, self.device, self.loop, self.hand) for one in scenes)


def _has_scene(world: World) -> bool:
    return isinstance(world, Scene) or (isinstance(world, Sum) and any(map(_has_scene, world.parts)))


@lru_cache(maxsize=64)
def _choose(
    loop: SampledLoop, hand: HandGrip, square: float, mass: float, step: float, stiffest: float
) -> tuple[float, float, float, str]:
    """Stiffness, damping, margin and their limit, for a body of `mass` with steps of `step` [s]. `square`: ratio of
    stiffness at the hand to stiffness at the body."""
    found = []
    for ratio in _RATIOS:
        # The damper 2 ζ √(K m) dissipates at most `_SLOW` of the momentum in a step.
        most = (_SLOW * mass / step / (2.0 * ratio)) ** 2 / mass
        low, high = _SOFT, min(most, stiffest)
        limit = "body"
        if _margin(loop, hand, square, mass, ratio, high) < MIN_STABILITY_MARGIN:
            limit = "loop"
            while high > 1.01 * low:
                middle = math.sqrt(low * high)
                if _margin(loop, hand, square, mass, ratio, middle) >= MIN_STABILITY_MARGIN:
                    low = middle
                else:
                    high = middle
            high = low
        found.append((high, ratio, limit))
    best = max(stiffness for stiffness, _, _ in found)
    stiffness, ratio, limit = next(one for one in found if one[0] >= _MIN_STIFFNESS_RATIO * best)
    return (
        stiffness,
        2 * ratio * math.sqrt(stiffness * mass),
        _margin(loop, hand, square, mass, ratio, stiffness),
        limit,
    )


def _margin(loop: SampledLoop, hand: HandGrip, square: float, mass: float, ratio: float, stiffness: float) -> float:
    return loop.largest(hand, square * stiffness, square * 2 * ratio * math.sqrt(stiffness * mass))


def _round(value: float) -> float:
    """Round down to three digits, for display."""
    if value <= 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return round(math.floor(value / unit) * unit, 12)
