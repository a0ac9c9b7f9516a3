"""Sliding friction on a compliant body: passive for any path, without memory.

A part presses on a spring-like body. Without friction the force on the body is f, the gradient of the stored energy
with respect to the part's position. With friction μ the force is inclined by arctan μ against the sliding. Two
points are easily overlooked:

1. Sliding is the motion of the part *relative to the body's surface*, and a hook's surface recoils along the hook while
the hook
   bends (by `recoil` = χ times its bending). If the direction of pulling decided instead, as eqs. (10) and (15) of Bai
   2012 read at face value, a hand could bend the hook while pulling (soft) and release it while pushing (stiff) and
   gain energy. With the sliding velocity v_s = v_t − χ v_n this is impossible: the input power is dU/dt + μ N |v_s|.
2. The sign of v_s is smoothed, v_s/√(v_s² + creep²): below the creep speed friction is viscous. A part at rest has
   none; on a slope it therefore creeps.

When the part is only pulled along (v_n = 0) on the top of the hook this is eq. (15) exactly:
N = E w δ/(Ω₊ ± μ Ω₋) with χ = Ω₋/Ω₊.
"""

from __future__ import annotations

import math

from haptorb.numerics.compiled import kernel

__all__ = ["sliding_push"]


@kernel
def sliding_push(
    fx: float, fy: float, recoil: float, vx: float, vy: float, vz: float, friction: float, creep: float
) -> tuple[float, float, float]:
    """(gx, gy, gz), the force on the body with friction [N]; (fx, fy) without it, in the x–y plane of the contact.

    The face's tangent is (fx, fy) turned by −90°. recoil is χ, along that tangent; v is the part's velocity at the
    contact [m/s]; sliding along z counts too. Valid while μ |χ| < 1, else the contact jams.
    """
    size = math.sqrt(fx * fx + fy * fy)
    if size == 0.0:
        return 0.0, 0.0, 0.0
    nx, ny = fx / size, fy / size
    tx, ty = ny, -nx
    slip = (tx * vx + ty * vy) - recoil * (nx * vx + ny * vy)
    speed = math.sqrt(slip * slip + vz * vz + creep * creep)
    along, across = slip / speed, vz / speed
    normal = size / (1.0 + friction * along * recoil)
    drag = friction * normal * along
    return normal * nx + drag * tx, normal * ny + drag * ty, friction * normal * across
