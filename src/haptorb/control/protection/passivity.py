"""Energy that a loop makes out of nothing, watched as it runs, and bounded damping against it.

A passive world gives back at most what it was given. Rendered by a loop it gives more: the force of a place is held
while the hand moves on, and is late. That excess is seen as it arises. Between two poses the device gave
a·Δp, with a the mean of what was asked in that very time; the world would have given ½(f₁ + f₂)·Δp, with f at the two
poses. The difference was made by sampling and delay. What even a loose hand takes out, b|Δp|²/Δt, is set against it.

    balance += b |Δp|²/Δt − (a − ½(f₁ + f₂))·Δp,  at most CREDIT;  below zero: damp

For a spring K under a steady movement this is b > K (T/2 + t_d), the condition of `stability`, tick by tick: a world
inside its loop's bound is never touched, however much energy it stores, and one outside is touched within milliseconds.
After Hannaford and Ryu 2002, who count all the energy from the start; see decision 0013 for why not here.
"""

from __future__ import annotations

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.numerics.compiled import kernel

__all__ = ["CREDIT", "OWN_DAMPING", "PassivityControl", "watched"]

OWN_DAMPING = 1.0  #: that the loosest hand is believed to have [N·s/m]
CREDIT = 2e-4  #: energy that may be made before anything is done: 0.1 kg at 6 cm/s [J]
_DEBT = 1e-2  #: more is not remembered [J]
_MOST = 10.0  #: damping that is ever injected [N·s/m]
_LIGHTEST = 0.1  #: mass of the lightest hand [kg]: late damping beyond a quarter of m/delay would itself oscillate
_PAUSE = 0.1  #: after a longer pause without a pose the count goes on from there [s]
_SOON = 1e-9  #: poses nearer to each other are one [s]
_MOVED = 1e-9  #: [m]; less is no movement
_NOWHERE = np.eye(3)
_TICKS = 512  #: of memory: more than the expiry of a pose at the fastest rate

#: rows of the memory, shape (_TICKS + 9, 7): first a ring of [since when, wrench]; then, each as long as it is,
#: numbers, settings, position, rotation, what the world asked there, motion since the pose before, and two for sums
_NUMBERS, _SETTINGS, _PLACE, _ROTATION, _FELT, _MOTION, _ACTED = (_TICKS + n for n in (0, 1, 2, 3, 6, 7, 8))
_ROWS = _TICKS + 9
#: columns of the numbers, and of the settings
_ENERGY, _BALANCE, _DAMPING, _STAMP, _FRESH, _COUNT, _SINCE = range(7)
_ARM, _DT, _LAG = range(3)


@kernel
def _acted(memory: Array, start: float, end: float) -> None:
    """Row _ACTED: the mean of what was asked from `start` to `end` [s]; each wrench acts until the next."""
    count = int(memory[_NUMBERS, _COUNT])
    out = memory[_ACTED]
    out[:] = 0.0
    until = np.inf
    for back in range(min(count, _TICKS)):
        asked = memory[(count - 1 - back) % _TICKS]
        share = (min(until, end) - max(asked[0], start)) / (end - start)
        if share > 0.0:
            for i in range(6):
                out[i] += share * asked[1 + i]
        if asked[0] <= start:
            break
        until = asked[0]


@kernel
def _settled(
    memory: Array, wrench: Array, p: Array, R: Array, stamp: float, passed: float, late: float, gain: float,
    passive: bool,
) -> None:  # fmt: skip
    """Count the energy between the last pose and this one, and choose the damping."""
    numbers, settings, place, felt = memory[_NUMBERS], memory[_SETTINGS], memory[_PLACE], memory[_FELT]
    acted, step = memory[_ACTED], memory[_MOTION]
    arm, lag = settings[_ARM], settings[_LAG]
    _acted(memory, numbers[_STAMP] - lag, stamp - lag)
    for i in range(3):
        step[i] = p[i] - place[i]
        step[3 + i] = 0.0
    if arm > 0.0:  # the small turn R₂R₁ᵀ as a vector
        for k in range(3):
            a0, a1, a2 = memory[_ROTATION, k], memory[_ROTATION + 1, k], memory[_ROTATION + 2, k]
            step[3] += 0.5 * (a1 * R[2, k] - a2 * R[1, k])
            step[4] += 0.5 * (a2 * R[0, k] - a0 * R[2, k])
            step[5] += 0.5 * (a0 * R[1, k] - a1 * R[0, k])
    given, due, square = 0.0, 0.0, 0.0
    for i in range(6 if arm > 0.0 else 3):  # nothing turns the tool but what the magnets do of themselves
        given += acted[i] * step[i]
        due += 0.5 * (felt[i] + gain * wrench[i]) * step[i]
        square += step[i] * step[i] if i < 3 else arm * arm * step[i] * step[i]
    for i in range(6):
        step[i] /= passed
    numbers[_ENERGY] += given
    balance = numbers[_BALANCE] + OWN_DAMPING * square / passed - (given - due)
    numbers[_BALANCE] = min(max(balance, -_DEBT), CREDIT)
    numbers[_DAMPING] = 0.0
    if passive and balance < 0.0 and square > _MOVED * _MOVED:
        most = min(_MOST, 0.25 * _LIGHTEST / (settings[_DT] + passed + late + lag))
        numbers[_DAMPING] = min(most, -balance * passed / square)


@kernel
def watched(
    memory: Array, wrench: Array, p: Array, R: Array, now: float, age: float, gain: float, passive: bool, out: Array
) -> None:
    """One tick: bring the balance up to this pose, fill out (6,) with `wrench` and the damping that it needs.

    memory is a `PassivityControl`'s; wrench (6,) [N, N·m], p (3,) [m], R (3, 3), now and age [s], gain 0 to 1.
    """
    numbers, place, arm = memory[_NUMBERS], memory[_PLACE], memory[_SETTINGS, _ARM]
    total = now + age
    moved = 0.0
    for i in range(6):
        total += wrench[i]
        out[i] = wrench[i]
    for i in range(3):
        total += p[i]
        moved += abs(p[i] - place[i])
        if arm > 0.0:
            total += R[i, 0] + R[i, 1] + R[i, 2]
    if not np.isfinite(total):  # the guard's business; nothing is counted, and everything begins anew
        numbers[_STAMP], numbers[_DAMPING] = -np.inf, 0.0
        return
    stamp = now - max(age, 0.0)
    if moved > _MOVED and stamp <= numbers[_SINCE]:  # its stamp stands while it moves: it is of now, as predicted
        if numbers[_FRESH] <= 0.0:
            numbers[_STAMP] = -np.inf
        numbers[_FRESH] = _TICKS
    numbers[_SINCE] = max(stamp, numbers[_SINCE])
    if numbers[_FRESH] > 0.0:
        numbers[_FRESH] -= 1.0
        stamp = now
    passed = stamp - numbers[_STAMP]
    if passed > _PAUSE or passed < 0.0:
        memory[_MOTION] = 0.0
        numbers[_DAMPING] = 0.0
    elif passed > _SOON:
        _settled(memory, wrench, p, R, stamp, passed, now - stamp, gain, passive)
    if passed > _SOON or passed < 0.0:
        numbers[_STAMP] = stamp
        for i in range(3):
            place[i] = p[i]
            for j in range(3):
                memory[_ROTATION + i, j] = R[i, j]
        for i in range(6):
            memory[_FELT, i] = gain * wrench[i]
    damping = numbers[_DAMPING]
    if damping > 0.0:
        for i in range(3):
            out[i] -= damping * memory[_MOTION, i]
            out[3 + i] -= damping * arm * arm * memory[_MOTION, 3 + i]
    at = int(numbers[_COUNT]) % _TICKS
    memory[at, 0] = now
    for i in range(6):
        memory[at, 1 + i] = gain * out[i]
    numbers[_COUNT] += 1.0


class PassivityControl:
    """Watches one loop of ticks `dt` [s] apart; one `damped` per tick, nothing allocated.

    arm  at which a hand holds a mover that turns [m]; 0 for a tool, whose force alone is rendered
    lag  by which what is asked comes late through the coils [s]
    """

    def __init__(self, dt: float, arm: float = 0.0, lag: float = 0.0) -> None:
        self.memory: Array = np.zeros((_ROWS, 7))  #: all that it remembers, for compiled code
        self.memory[_SETTINGS, :3] = arm, dt, lag
        #: (3,) energy [J] given to the hand since the world began; balance [J]; damping injected now [N·s/m]
        self.numbers: Array = self.memory[_NUMBERS, :3]
        self._out = np.zeros(6)
        self.restart()
        self.damped(self._out, _NOWHERE[0], _NOWHERE, 0.0, 0.0, 0.0, passive=False)  # compiled now
        self.restart()

    def restart(self) -> None:
        """Another world: what is asked from now on has nothing to do with what was."""
        self.memory[_NUMBERS] = 0.0, CREDIT, 0.0, -np.inf, 0.0, 0.0, -np.inf
        self.memory[_MOTION] = 0.0

    def damped(self, wrench: Array, p: Array, R: Array, now: float, age: float, gain: float, *, passive: bool) -> Array:
        """(6,) `wrench` with the damping that the balance asks for; itself while there is none to add.

        p (3,), R (3, 3) the pose, `age` [s] old at `now` [s]; gain 0 to 1 is what the guard lets through. A world that
        is not `passive` is watched and left alone.
        """
        watched(self.memory, wrench, p, R, now, age, gain, passive, self._out)
        return self._out
