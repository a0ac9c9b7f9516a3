"""What a tick does with a world's wrench, in two compiled passes around the allocator: what is asked, what is driven.

The rules are those of passivity control, guard and drive; they are strung together here because a call into compiled
code costs more than most of them do.
"""

from __future__ import annotations

from haptorb.control.protection.current_check import check_currents
from haptorb.control.protection.drive import EMF, drive, rest
from haptorb.control.protection.drive import pass_time as pass_drive_time
from haptorb.control.protection.guard_rules import GAIN, HELD, admit, limit, pass_time
from haptorb.control.protection.heat_observer import ELAPSED, WINDING
from haptorb.control.protection.passivity import watched
from haptorb.numerics.arrays import Array, Records
from haptorb.numerics.compiled import kernel
from haptorb.runtime.tick.fill_row import induced

__all__ = ["asked", "driven"]


@kernel
def asked(
    passivity: Array, guard: Array, held: Array, clock: Records, wrench: Array, p: Array, R: Array, now: float,
    age: float, passive: bool, valid: bool, reversed: bool, out: Array,
) -> None:  # fmt: skip
    """out (6,) [N, N·m] becomes what may be asked of the coils for the world's `wrench` (6,): damped, then admitted.

    passivity and guard, held, clock are the memories of a `PassivityControl` and a `Guard`; the rest is the estimate's.
    The tick begins here, at `now` [s].
    """
    pass_time(guard, held, clock, now)
    watched(passivity, wrench, p, R, now, age, guard[GAIN], passive, out)
    admit(guard, out, valid, age, reversed, out)


@kernel
def driven(
    guard: Array, held: Array, clock: Records, heat: Array, windings: Array, check: Records, numbers: Array,
    coils: Array, wanted: Array, measured: Array, age: float, temperatures: Array, applied: Array, matrix: Array,
    v: Array, w: Array,
) -> None:  # fmt: skip
    """From `wanted` currents (m,) [A] to duties: what the guard lets flow, then what the drive makes of it.

    guard, held, clock, heat, windings and check are a `Guard`'s memory, numbers and coils a `Drive`'s; measured (m,)
    [A], `age` [s] old, and temperatures (m,) [K] are readings, applied (m,) the last duties, matrix (6, m) the wrench
    per ampere against which a mover with velocity v (3,) [m/s] and w (3,) [rad/s] induces a voltage.
    """
    elapsed = clock[0].elapsed
    heat[ELAPSED] = elapsed
    pass_drive_time(numbers, elapsed)
    # What the coils push against: the power that they give to the mover, per ampere.
    induced(matrix, v, w, coils[EMF])
    plausible = check_currents(
        check, elapsed, clock[0].restart, applied, measured, age, windings[WINDING], coils[EMF]
    )  # fmt: skip
    limit(guard, held, heat, windings, wanted, measured, temperatures, plausible)
    if guard[GAIN] > 0.0:
        drive(numbers, coils, held[HELD], measured, applied)
    else:
        rest(coils)
