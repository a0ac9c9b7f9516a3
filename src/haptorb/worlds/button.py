"""Button on the dome with travel and click that latches until it is pressed again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from haptorb.arrays import Array, Record, Records, fields
from haptorb.compiled import kernel
from haptorb.devices.base import Device, State
from haptorb.errors import InputError
from haptorb.worlds.base import Shape, World, parameter
from haptorb.worlds.dynamic import DynamicWorld, MemoryField, make_memory

__all__ = ["Button"]

_FIELDS = (
    MemoryField("pressed", "1", "1 while the button stays pressed"),
    MemoryField("armed", "1", "1 if the next press counts: released since the last press"),
    MemoryField("depth", "m", "depth of the key below its highest position"),
    MemoryField("cap", "m", "centre of the drawn key, under the tool's tip, stator frame", (3,)),
    MemoryField("attitude", "1", "orientation of the key, quaternion (x, y, z, w)", (4,)),
    MemoryField("energy", "J", "energy in spring, click and latch"),
)

# Shares of the travel
_LATCH = 0.45  # rest position of a latched key
_CLICK = 0.55  # centre of the click
_WIDTH = 0.30  # of the click
_EQUAL_FORCE = 0.80  # from here the forces of a latched and a free key are equal
_TRANSITION = 0.88  # transition between latched and free
_KEY_THICKNESS_M = 2e-3  #: displayed thickness of the key [m]
_RETURN_SPEED_M_S = 0.15  #: speed of a released key on its return [m/s]

#: Settings of the kernel.
_BUTTON = fields(
    ("axis", "f8", (3,)),  # unit vector to the button
    ("lift", "f8"),  # of the tool's magnet above its tip [m]
    ("bottom", "f8"),  # distance from the dome's centre at full travel [m]
    ("travel", "f8"),  # [m]
    ("radius", "f8"),  # radius of the flat key [m]
    ("edge", "f8"),  # width of the edge, over which the force falls to zero [m]
    ("spring", "f8"),  # [N/m]
    ("preload", "f8"),  # [N]
    ("click", "f8"),  # amplitude [N]
    ("stop", "f8"),  # stiffness behind the travel [N/m]
    ("latch_energy", "f8"),  # [J]
)


@kernel
def _rise(x: float) -> float:
    """Smooth step from 0 at x = 0 to 1 at x = 1."""
    s = min(max(x, 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


@kernel
def _free(b: Record, depth: float) -> float:
    """Force of a free key at `depth` [m], without the end stop [N]."""
    share = depth / b.travel
    if share <= 0.0:
        return 0.0
    x = (share - _CLICK) / _WIDTH + 0.5
    click = np.sin(2.0 * np.pi * x) * np.sin(np.pi * x) if 0.0 < x < 1.0 else 0.0
    return float(b.preload * _rise(share / 0.08) + b.spring * depth + b.click * click)


@kernel
def _force(b: Record, depth: float, pressed: bool) -> float:
    """Force of the key at `depth` [m], free or latched [N]."""
    share = depth / b.travel
    if pressed:
        return _free(b, depth) * _rise((share - _LATCH) / (_EQUAL_FORCE - _LATCH))
    return _free(b, depth)


@kernel
def _work(b: Record, depth: float, pressed: bool) -> float:
    """∫ force from the top to `depth` [J], by three-point Gauss quadrature over its smooth pieces."""
    total, low = 0.0, 0.0
    for piece in range(24):
        high = min(depth, (piece + 1) * b.travel / 20.0) if piece < 23 else depth
        if high <= low:
            continue
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        away = np.sqrt(0.6) * half
        sides = _force(b, middle - away, pressed) + _force(b, middle + away, pressed)
        total += half / 9.0 * (5.0 * sides + 8.0 * _force(b, middle, pressed))
        low = high
    return total


@kernel
def _measure_latch(button: Records) -> float:
    """Energy stored in a latched key: difference in work to a free one [J]."""
    b = button[0]
    return _work(b, b.travel, False) - _work(b, b.travel, True)


@kernel
def _press(memory: Records, button: Records, p: Array, dt: float, wrench: Array) -> None:
    """Follow the tool at `p` (3,) [m]; `wrench` (6,) becomes the force on it [N]."""
    m, b = memory[0], button[0]
    wrench[:] = 0.0
    d = np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    if d < 1e-6:
        return
    cosine = min(1.0, max(-1.0, (p[0] * b.axis[0] + p[1] * b.axis[1] + p[2] * b.axis[2]) / d))
    aside = d * np.arccos(cosine)
    over = (aside - b.radius) / b.edge  # from the flat key to zero
    held = 1.0 - _rise(over)
    depth = max(b.bottom + b.travel - d, 0.0) if held > 0.0 else 0.0
    share = depth / b.travel
    # The forces of both states are equal at the transition, which occurs only in the flat middle: no energy is
    # generated.
    if share >= _TRANSITION and over <= 0.0 and m.armed == 1.0:
        m.pressed, m.armed = 1.0 - m.pressed, 0.0
    elif share < _LATCH:
        m.armed = 1.0
    pressed = m.pressed == 1.0
    stopped = max(depth - b.travel, 0.0)
    push = _force(b, depth, pressed) + b.stop * stopped
    work = _work(b, depth, pressed) + 0.5 * b.stop * stopped * stopped
    # Gradient of held · work: outwards, and away from the middle at the edge.
    sine = np.sqrt(max(1.0 - cosine * cosine, 0.0))
    slide = 0.0
    if 0.0 < over < 1.0 and sine > 1e-9:
        fall = 6.0 * over * (1.0 - over) / b.edge
        slide = work * fall
    for i in range(3):
        outward = p[i] / d
        away = (cosine * outward - b.axis[i]) / sine if sine > 1e-9 else 0.0
        wrench[i] = held * push * outward + slide * (away + aside / d * outward)
    m.energy = held * work + (b.latch_energy if pressed else 0.0)
    rest = _LATCH * b.travel if pressed else 0.0
    goal = max(min(depth, 1.05 * b.travel), rest)
    m.depth = goal if goal >= m.depth else max(goal, m.depth - _RETURN_SPEED_M_S * dt)
    for i in range(3):
        m.cap[i] = (b.bottom + b.travel - m.depth - b.lift) * b.axis[i]


@dataclass(frozen=True)
class Button(DynamicWorld):
    """Button with travel and click that latches: press it once to lock it, again to release it.

    A spring under a flat round key, a click in the middle of its travel (the force rises, then falls), and a stop. A
    press beyond 88 % of the travel changes its state; a locked key rests at 45 % of the travel. Both states are
    gradients of a potential with the same force at the transition, so energy is conserved: the latch stores the
    difference. Beside the flat key its edge pushes the tool away.

    Parameters
    ----------
    bottom : float
        Distance of the tool's magnet from the dome's centre at full travel [m], positive; `for_device` sets it.
    lift : float
        Height of the magnet above the tip of a radial tool [m], not negative; `for_device` sets it.

    Examples
    --------
    >>> button = Button()
    >>> bool(button.wrench(State.at((0, 0, button.bottom + 0.002)))[2] > 0)
    True
    """

    asks = "force"

    summit: tuple[float, float, float] = parameter((0.0, 0.0, 1.0), "1", -1, 1, "direction of the button")
    travel: float = parameter(0.006, "m", 0.002, 0.015, "travel from the key's highest position to its stop")
    radius: float = parameter(0.010, "m", 0.004, 0.03, "radius of the flat key")
    spring: float = parameter(40.0, "N/m", 0, 150, "stiffness of its spring")
    preload: float = parameter(0.03, "N", 0, 0.3, "force at the beginning of the travel")
    click: float = parameter(0.12, "N", 0, 0.5, "force amplitude of the click")
    stop: float = parameter(200.0, "N/m", 50, 500, "stiffness at the end of the travel")
    bottom: float = 0.0505
    lift: float = 0.020

    def __post_init__(self) -> None:
        World.__post_init__(self)
        if not np.linalg.norm(self.summit) > 1e-6:
            raise InputError("Button.summit must be a direction; got the zero vector")

    @property
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """State of the key."""
        return _FIELDS

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """The key."""
        return (Shape("key", "cylinder", (self.radius, 0.5 * _KEY_THICKNESS_M), "cap", "attitude"),)

    @property
    def bound(self) -> float:
        """[N] for a tool that penetrates the dome by at most 6 mm."""
        top = self.preload + self.spring * (self.travel + 0.0065) + self.click
        return 1.5 * (top + self.stop * 0.0065)

    def for_device(self, device: Device) -> Button:
        """With the button on the dome of `device`. Raises InputError for a device without one, or a summit below its
        rim."""
        shell = device.shell
        if shell is None:
            raise InputError(f"world 'button' is for a tool over a sphere; device '{device.name}' has none")
        if self.summit[2] < 0.0:
            raise InputError(
                f"Button.summit {tuple(self.summit)} lies below the rim of the dome of device '{device.name}': its z "
                "must not be negative"
            )
        return replace(self, bottom=shell.contact_distance + 0.0005, lift=shell.contact_distance - shell.dome_radius)

    @cached_property
    def _facts(self) -> Records:
        """(1,) _BUTTON: constant settings."""
        made = np.zeros(1, dtype=_BUTTON)
        made["axis"] = np.asarray(self.summit) / np.linalg.norm(self.summit)
        made["edge"] = 0.4 * self.radius
        for name in ("bottom", "lift", "travel", "radius", "spring", "preload", "click", "stop"):
            made[name] = getattr(self, name)
        made["latch_energy"] = _measure_latch(made)
        return made

    def begin(self) -> Records:
        """Initial state: released and armed."""
        memory, axis = make_memory(_FIELDS), self._facts["axis"][0]
        memory["armed"] = 1.0
        memory["cap"] = (self.bottom + self.travel - self.lift) * axis
        turn = np.array([-axis[1], axis[0], 0.0, 1.0 + axis[2]])  # rotation from z to the axis
        memory["attitude"] = turn / np.linalg.norm(turn) if turn.any() else (1.0, 0.0, 0.0, 0.0)
        return memory

    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) force of the key on the tool [N], `dt` [s] after the previous tick."""
        wrench = np.empty(6)
        _press(memory, self._facts, np.ascontiguousarray(state.p), dt, wrench)
        return wrench

    def keep(self, memory: Records, previous: DynamicWorld, old: Records) -> None:
        """It keeps pressed and armed; everything else follows."""
        if previous.name == self.name and old.dtype == memory.dtype:
            memory["pressed"], memory["armed"] = old["pressed"], old["armed"]
