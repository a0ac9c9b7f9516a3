"""Snap-fit: cantilever hooks and the mating part that slides over their wedges.

Frame: X' points out of the socket (pulling apart is +X'), Y' towards one hook; `state` is the pose of the part's
reference point o' (devices.State: p and R_SR in that frame), which is at the origin when the part is seated. Each
hook is touched by one edge of the part. Bai 2012, eqs. (10)–(13), Fig. 6.

The hand feels, during insertion: the front face, the top, then the snap; during removal: the rear face, the top,
and the release down the front. There is no memory: the position of the edge and its direction of sliding
determine the force.

The hook is an elastic body: a force at x bends it by Ω₊ f_y + Ω₋ f_x and moves its surface along by Ω₋ f_y + Ωₓ f_x,
over E w. The edge of the part, at (X, Y), touches the place x where the energy U = ½ fᵀ Ω(x) f is stationary: virtual
work. The force without friction is its gradient, and the turn of the face by the bending, which (11) adds as
arctan(δ/x), is in it through the change of Ω₊, Ω₋ and Ωₓ along the hook (erratum E27). Friction then leans the force
on the turned face, at the same place of the hook. `beams.balance_face` computes the same force in another way, for
sharp edges. Here edges are rounded, so the force is continuous. Left out: tilt of the wedge across its width, inertia
of the hook, wear.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from haptorb.arrays import Array, Record, Records, cubic_spline, fields
from haptorb.beams import MATERIALS, TABLE_3, Hook, Model, appendix_b, balance_face, compliance, root_strain
from haptorb.compiled import kernel, tick_kernel
from haptorb.devices.base import State
from haptorb.errors import GeometryError, InputError
from haptorb.worlds.base import ContactWorld, ObjectWorld, parameter

__all__ = [
    "CONTACT",
    "HookContact",
    "Outlet",
    "PublishedOutlet",
    "RootLoad",
    "SnapFit",
    "add_contact",
    "compute_root_load",
    "sliding_push",
    "view_contacts",
]


# --------------------------------------------------------------------------------------------------
# State of one hook at an instant: filled by compiled code, and for drawing.


#: Fields of a contact in the order of `ContactWorld.render_contacts`.
CONTACT = fields(
    ("deflection", "f8"),  # bending of the hook at the contact [m]
    ("place", "f8"),  # position of the contact along the hook, from the root [m]
    ("point", "f8", (3,)),  # position of the contact [m]
    ("force", "f8", (3,)),  # on the part [N]
)


class HookContact(NamedTuple):
    """Contact point of a hook, force and deflection."""

    face: str  #: "rear", "top" or "front", "" without contact
    point: Array  #: (3,) position of the contact [m]
    force: Array  #: (3,) on the part [N]
    deflection: float  #: bending of the hook at the contact [m]
    place: float  #: position of the contact along the hook, from the root [m]


def view_contacts(rows: Array) -> Records:
    """(n,) CONTACT, fields in [m] and [N]; a view of rows (n, 8)."""
    return np.ndarray(len(rows), CONTACT, rows)  # rows.view takes three times as long


@kernel
def add_contact(contact: Record, wrench: Array, p: Array, rx: float, ry: float, rz: float) -> None:
    """Put `contact`, a CONTACT with its force, at the arm (rx, ry, rz) from p (3,) [m]; add its force to wrench (6,),
    whose torque is about p."""
    contact.point[0], contact.point[1], contact.point[2] = p[0] + rx, p[1] + ry, p[2] + rz
    fx, fy, fz = contact.force[0], contact.force[1], contact.force[2]
    wrench[0] += fx
    wrench[1] += fy
    wrench[2] += fz
    wrench[3] += ry * fz - rz * fy
    wrench[4] += rz * fx - rx * fz
    wrench[5] += rx * fy - ry * fx


# --------------------------------------------------------------------------------------------------
# Load at the root of a hook at its largest deflection, compared with the material's yield strength.


@dataclass(frozen=True)
class RootLoad:
    """Largest bending strain and stress at the root during straight insertion and removal; linear, without friction.

    >>> RootLoad("ABS", 0.02, 46e6).sentence.partition("; ")[0]
    'root strain 2 %, stress 46 MPa: BEYOND YIELD of ABS (44 MPa), 1.05 times its yield strength'
    """

    material: str
    strain: float
    stress: float  #: E ε [Pa]
    stated_strength: float | None = None  #: yield strength used instead of the table's [Pa]

    @property
    def yield_strength(self) -> float | None:
        """Yield strength of the named material [Pa]; None if the material is not in the table and none is stated."""
        if self.stated_strength is not None:
            return self.stated_strength
        known = MATERIALS.get(self.material)
        return None if known is None else known.yield_strength

    @property
    def margin(self) -> float | None:
        """Yield strength over stress: below 1 the hook deforms permanently. None if the yield strength is not known."""
        return None if self.yield_strength is None or self.stress <= 0.0 else self.yield_strength / self.stress

    @property
    def beyond_yield(self) -> bool:
        """Whether the stress exceeds the yield strength."""
        return self.margin is not None and self.margin < 1.0

    @property
    def breaks(self) -> bool:
        """Whether the strain exceeds the strain at break of the named material: the hook breaks during insertion."""
        known = MATERIALS.get(self.material)
        return known is not None and self.strain > known.breaking_strain

    @property
    def sentence(self) -> str:
        """Summary in one line."""
        return self._describe_yield() + self._describe_strain()

    def _describe_strain(self) -> str:
        known = MATERIALS.get(self.material)
        if known is None:
            return ""
        if self.breaks:
            end = 100 * known.breaking_strain
            return f"; BREAKS BEFORE IT SNAPS: {self.material} breaks at a strain of {end:.3g} %"
        once, often = known.permissible_strain, known.repeated_strain
        limits = f"; permissible strain {100 * once:.3g} %"
        if often < once:
            limits += f" once, {100 * often:.3g} % if opened often"
        if self.strain > once:
            return f"{limits}: EXCEEDED {self.strain / once:.3g} times"
        return f"{limits}: EXCEEDED if opened often" if self.strain > often else limits

    def _describe_yield(self) -> str:
        begin = f"root strain {100 * self.strain:.3g} %, stress {_megapascal(self.stress)}"
        if self.margin is None or self.yield_strength is None:
            return f"{begin}; the yield strength of '{self.material}' is not known (yield_strength in a snap-fit file)"
        of = f"{self.material} ({_megapascal(self.yield_strength)})"
        if self.beyond_yield:
            return f"{begin}: BEYOND YIELD of {of}, {1 / self.margin:.3g} times its yield strength"
        return f"{begin}: below the yield strength of {of} by a factor of {self.margin:.3g}"

    def numbers(self) -> dict[str, float | str | bool | None]:
        """Plain JSON types, SI, units in the names."""
        known = MATERIALS.get(self.material)
        return {
            "material": self.material, "root_strain": self.strain, "root_stress_pa": self.stress,
            "yield_strength_pa": self.yield_strength, "yield_margin": self.margin, "beyond_yield": self.beyond_yield,
            "permissible_strain": None if known is None else known.permissible_strain,
            "permissible_strain_often": None if known is None else known.repeated_strain,
            "breaks": self.breaks,
        }  # fmt: skip


def compute_root_load(hook: Hook, places: Array, deflections: Array, plus: Array, material: str) -> RootLoad:
    """The largest over contacts at `places` (n,) [m] from the root that bend `hook` by `deflections` (n,) [m], where
    its compliance is Ω₊ = `plus` (n,)."""
    strain = float(np.max(root_strain(hook, places, deflections, plus), initial=0.0))
    return RootLoad(material, strain, hook.youngs_modulus * strain)


def _megapascal(stress: float) -> str:
    return f"{stress / 1e6:.3g} MPa" if stress < 1e9 else f"{stress / 1e9:.3g} GPa"


# --------------------------------------------------------------------------------------------------
# Sliding friction on a compliant body: passive for any path, without memory.
#
# A part presses on a spring-like body. Without friction the force on the body is f, the gradient of the stored energy
# with respect to the part's position. With friction μ the force is inclined by arctan μ against the sliding direction.
# Two points are easily overlooked:
#
# 1. Sliding is the motion of the part *relative to the body's surface*, and a hook's surface recoils along the hook
#    while the hook bends (by `recoil` = χ times its bending). If the direction of pulling were used instead, as
#    eqs. (10) and (15) of Bai 2012 suggest, a hand could bend the hook while pulling (soft) and release it while
#    pushing (stiff) and gain energy. With the sliding velocity v_s = v_t − χ v_n this is impossible: the input power is
#    dU/dt + μ N |v_s|.
# 2. The sign of v_s is smoothed, v_s/√(v_s² + creep²): below the creep speed friction is viscous. A part at rest has
#    none; on a slope it therefore creeps.
#
# When the part is only pulled along (v_n = 0) on the top of the hook this is eq. (15) exactly:
# N = E w δ/(Ω₊ ± μ Ω₋) with χ = Ω₋/Ω₊.


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


#: Settings of the kernel of a snap-fit.
_SNAP = fields(
    ("foot", "f8"), ("top", "f8"),  # of the rear face: start and end, from the root [m]
    ("peak", "f8"),  # start of the front face [m]
    ("rear", "f8"), ("front", "f8"),  # slopes of the two faces
    ("edge", "f8"),  # half length of the rounding [m]
    ("friction", "f8"), ("creep", "f8"),  # μ, and the speed below which it is viscous [m/s]
    ("half", "f8"),  # from the part's middle to its edge [m]
    ("clearance", "f8"),  # [m]
    ("seat", "f8"),  # [N/m]
    ("start", "f8"), ("step", "f8"),  # of the table of compliances [m]
    ("hooks", "i8"),
    ("springs", "i8"),  # 1 if the edge jumps over a corner instead of sliding
)  # fmt: skip

#: Contact without friction, as computed by the kernel.
_TOUCH = fields(
    ("place", "f8"), ("bent", "f8"),  # position along the hook, and deflection [m]
    ("slope", "f8"),  # of the undeformed face
    ("fx", "f8"), ("fy", "f8"),  # on the hook [N]
    ("shift", "f8"),  # of the contact along the hook [m]
    ("bend", "f8"), ("recoil", "f8"),  # f_y + κ f_x [N], determined by δ, and κ = Ω₋/Ω₊
    ("turning", "f8"),  # rotation of the face per pull at the same δ [rad/N]
)  # fmt: skip

_MIN_TABLE_PLACES, _MAX_TABLE_PLACES = 257, 8193  #: places in the table of compliances
_MAX_SEARCH_STEPS = 400  #: limit of the search for a hook that jumps: 20 µs
_MIN_DIVISOR = 0.05  #: lower limit of divisors, which only a hook bent far beyond this theory would reach


@kernel
def _round_corner(u: float, edge: float) -> tuple[float, float]:
    """max(u, 0) with the corner rounded over ±edge, and its slope."""
    if u >= edge:
        return u, 1.0
    if u <= -edge:
        return 0.0, 0.0
    return (u + edge) ** 2 / (4.0 * edge), (u + edge) / (2.0 * edge)


@kernel
def _wedge(x: float, snap: Record) -> tuple[float, float]:
    """Height of the wedge over the base beam at x, and its slope; the front face is extended beyond the tip."""
    a, da = _round_corner(x - snap.foot, snap.edge)
    b, db = _round_corner(x - snap.top, snap.edge)
    c, dc = _round_corner(x - snap.peak, snap.edge)
    return snap.rear * (a - b) - snap.front * c, snap.rear * (da - db) - snap.front * dc


@kernel
def _touch(x: float, Y: float, snap: Record, table: Array, touch: Record) -> None:
    """Fill `touch`, a _TOUCH, for an edge at the height Y that touches the hook at x, without friction.

    δ = Ω₊ f_y + Ω₋ f_x, and f_x = H' f_y − ½ fᵀ Ω' f: sliding along the face does no work.
    """
    H, dH = _wedge(x, snap)
    bent = max(0.0, H + Y)
    touch.place, touch.bent, touch.slope = x, bent, dH
    touch.fx, touch.fy, touch.shift = 0.0, 0.0, 0.0
    if bent == 0.0:
        return
    i = min(max(int((x - snap.start) / snap.step), 0), table.shape[0] - 1)
    s = max(x - (snap.start + i * snap.step), 0.0)
    row = table[i]
    plus = ((row[0] * s + row[1]) * s + row[2]) * s + row[3]
    minus = ((row[4] * s + row[5]) * s + row[6]) * s + row[7]
    along = ((row[8] * s + row[9]) * s + row[10]) * s + row[11]
    dplus, dminus, dalong = 0.0, 0.0, 0.0
    if x >= snap.start:
        dplus = (3.0 * row[0] * s + 2.0 * row[1]) * s + row[2]
        dminus = (3.0 * row[4] * s + 2.0 * row[5]) * s + row[6]
        dalong = (3.0 * row[8] * s + 2.0 * row[9]) * s + row[10]
    bend, recoil = bent / plus, minus / plus
    # f_y = bend − κ f_x substituted in the second equation: ½ a f_x² + b f_x = c
    a = dalong - 2.0 * recoil * dminus + recoil * recoil * dplus
    b = max(1.0 + recoil * dH + (dminus - recoil * dplus) * bend, _MIN_DIVISOR)
    c = bend * (dH - 0.5 * dplus * bend)
    fx = 2.0 * c / (b + math.sqrt(max(b * b + 2.0 * a * c, 0.0)))
    fy = bend - recoil * fx
    touch.fx, touch.fy, touch.shift = fx, fy, minus * fy + along * fx
    touch.bend, touch.recoil = bend, recoil
    touch.turning = dminus - 0.5 * dplus * (dH + recoil)


@kernel
def _narrow(
    low: float, at_low: float, high: float, at_high: float, X: float, Y: float, snap: Record, table: Array,
    touch: Record,
) -> None:  # fmt: skip
    """Find x between low and high with x + shift(x) = X and fill `touch`; at_low < 0 ≤ at_high are the residuals."""
    kept = 0
    for _ in range(80):  # false position (Illinois)
        span = at_high - at_low
        x = low - at_low * (high - low) / span if span > 0.0 else 0.5 * (low + high)
        if not low < x < high:
            x = 0.5 * (low + high)
        _touch(x, Y, snap, table, touch)
        new = x + touch.shift - X
        if abs(new) < 1e-15 or high - low < 1e-16:
            break
        if new > 0.0:
            high, at_high = x, new
            at_low *= 0.5 if kept > 0 else 1.0
            kept = 1
        else:
            low, at_low = x, new
            at_high *= 0.5 if kept < 0 else 1.0
            kept = -1


@kernel
def _find_least_energy(X: float, Y: float, reach: float, snap: Record, table: Array, touch: Record) -> bool:
    """Fill `touch` for the solution x within ±reach of X of x + shift(x) = X with the smallest stored energy."""
    least, place = math.inf, X
    steps = min(int(8.0 * reach / snap.edge) + 1, _MAX_SEARCH_STEPS)
    step = 2.0 * reach / steps  # a quarter of the rounding's half length: no two solutions are in one step
    low = X - reach
    _touch(low, Y, snap, table, touch)
    at_low = low + touch.shift - X
    for i in range(steps):
        high = X - reach + (i + 1) * step
        _touch(high, Y, snap, table, touch)
        at_high = high + touch.shift - X
        if at_low < 0.0 <= at_high:
            _narrow(low, at_low, high, at_high, X, Y, snap, table, touch)
            energy = touch.fy * touch.bent + touch.fx * touch.shift
            if energy < least:
                least, place = energy, touch.place
        low, at_low = high, at_high
    _touch(place, Y, snap, table, touch)
    return least < math.inf


@kernel
def _find_contact(X: float, Y: float, snap: Record, table: Array, touch: Record) -> None:
    """Fill `touch` for an edge at (X, Y): the position x on the hook with x + shift(x) = X.

    A hook that jumps over a sharp corner has several: the one with the lowest stored energy makes the energy
    continuous.
    """
    _touch(X, Y, snap, table, touch)
    gap = touch.shift
    if gap == 0.0:
        return
    if snap.springs and _find_least_energy(
        X, Y, 2.0 * abs(gap) + 4.0 * snap.edge + 0.5 * touch.bent, snap, table, touch
    ):
        return
    high, at_high, low, at_low = X, gap, X, gap
    reach = 1.5 * abs(gap)
    for _ in range(40):
        x = X - reach if gap > 0.0 else X + reach
        _touch(x, Y, snap, table, touch)
        new = x + touch.shift - X
        if gap > 0.0:
            low, at_low = x, new
        else:
            high, at_high = x, new
        if new * gap <= 0.0:
            break
        reach *= 2.0
    _narrow(low, at_low, high, at_high, X, Y, snap, table, touch)


@kernel
def _springs(places: Array, Y: float, snaps: Records, table: Array) -> bool:
    """Whether an edge at the height Y that moves over `places` (n,) [m] of the hook must reverse on its path."""
    touches = np.empty(1, _TOUCH)
    last = -math.inf
    for x in places:
        _touch(x, Y, snaps[0], table, touches[0])
        if x + touches[0].shift <= last:
            return True
        last = x + touches[0].shift
    return False


@kernel
def _rub(touch: Record, vx: float, vy: float, vz: float, friction: float, creep: float) -> tuple[float, float, float]:
    """(fx, fy, fz) on the hook [N] with friction, for a part that moves with v [m/s] at the contact, y away from it.

    At the same place and bending the force can only change along (1, −κ), and the part slides in the same direction:
    so friction dissipates energy for any motion. The face rotates with it.
    """
    fx, fy, slope, recoil = touch.fx, touch.fy, touch.slope, touch.recoil
    turn = (slope * fy - fx) / max(fy + slope * fx, 1e-300)  # without friction the force is normal to the face
    along, up = 1.0 + turn * slope, slope - turn  # the rotated face
    length = math.sqrt(along * along + up * up)
    slip = (vx - recoil * vy) * length / max(along + recoil * up, _MIN_DIVISOR)
    speed = math.sqrt(slip * slip + vz * vz + creep * creep)
    rub = friction * slip / speed
    rubbed, normal = fx, 0.0
    for _ in range(4):
        share = (up + rub * along) / max(along - rub * up + recoil * (up + rub * along), _MIN_DIVISOR)
        rubbed = touch.bend * share
        if (rubbed - fx) * rub < 0.0:
            rubbed = fx
        now = turn + touch.turning * (rubbed - fx)
        along, up = 1.0 + now * slope, slope - now
    fy = touch.bend - recoil * rubbed
    normal = (rubbed * up + fy * along) / math.sqrt(along * along + up * up)
    return rubbed, fy, friction * normal * vz / speed


@kernel
def _snap_fit(
    p: Array, R: Array, v: Array, w: Array, snaps: Records, table: Array, touches: Records, wrench: Array,
    contacts: Records,
) -> None:  # fmt: skip
    """Fill wrench (6,) on the part about o', and contacts (2,) CONTACT, zero on input.

    snaps is (1,) _SNAP, table (n, 12) the cubics of the hook's compliances, touches (1,) _TOUCH is overwritten.
    """
    snap, touch = snaps[0], touches[0]
    half, clearance, foot, seat = snap.half, snap.clearance, snap.foot, snap.seat
    for i in range(6):
        wrench[i] = 0.0
    for hook in range(snap.hooks):
        contact, side = contacts[hook], 1.0 if hook == 0 else -1.0
        # the edge is at (0, ±half, 0) of the part
        rx, ry, rz = R[0, 1] * side * half, R[1, 1] * side * half, R[2, 1] * side * half
        X = foot + p[0] + rx
        Y = side * (p[1] + ry) - half - clearance
        _find_contact(X, Y, snap, table, touch)
        gx, gy, gz = 0.0, 0.0, 0.0
        if touch.bent > 0.0:
            vx = v[0] + w[1] * rz - w[2] * ry
            vy = side * (v[1] + w[2] * rx - w[0] * rz)
            vz = v[2] + w[0] * ry - w[1] * rx
            gx, gy, gz = _rub(touch, vx, vy, vz, snap.friction, snap.creep)
        below = foot - X
        if below > 0.0:  # seat
            gx -= seat * below
        contact.force[0], contact.force[1], contact.force[2] = -gx, -side * gy, -gz
        add_contact(contact, wrench, p, rx, ry, rz)
        contact.deflection, contact.place = touch.bent, touch.place


@dataclass(frozen=True)
class SnapFit(ContactWorld, ObjectWorld):
    """Snap-fit: hooks bend, snap in, and retain the part until the pull-out force is exceeded.

    Sizes as in `haptorb.beams.Hook`. The default is a pair of ABS hooks of ordinary proportions (1.5 % strain at the
    root, about the limit of ABS in a joint that is opened often): a few newtons, which a motor of about 1 N·m renders
    through the modes without scaling. Raises GeometryError if the hook cannot exist, cannot be pushed in, or cannot be
    pulled out.

    Parameters
    ----------
    beam : {"timoshenko", "paper"}
        Model of the hooks: the correct beam, or eqs. (12) and (13) of the paper as printed.
    material : str
        Material of the hooks, a name of `haptorb.beams.MATERIALS` for the yield strength in `root_load`; it changes no
        force. With another name the yield strength is unknown.
    hooks : {2, 1}
        2: a pair that centres the part. 1: the part is pushed aside and needs a guide.

    Examples
    --------
    >>> world = SnapFit()
    >>> world.wrench(State.at((0.001, 0, 0), R_SR=np.eye(3), v=(0.05, 0, 0)))[0] < 0      # pulled: it holds back
    np.True_
    """

    youngs_modulus: float = parameter(2.3e9, "Pa", 0.1e9, 250e9, "E of the hook's material")
    poisson_ratio: float = parameter(0.35, "", 0.0, 0.49, "ν of the hook's material")
    friction: float = parameter(0.3, "", 0.0, 1.0, "μ between hook and part")
    base_length: float = parameter(15e-3, "m", 2e-3, 40e-3, "distance from the root to the foot of the rear face")
    peak: float = parameter(18.5e-3, "m", 3e-3, 50e-3, "distance from the root to the start of the front face")
    thickness: float = parameter(1.5e-3, "m", 0.2e-3, 5e-3, "thickness of the beam")
    height: float = parameter(1.5e-3, "m", 0.2e-3, 5e-3, "height of the wedge")
    width: float = parameter(6e-3, "m", 1e-3, 30e-3, "width of the hook")
    insertion_deg: float = parameter(30.0, "°", 5.0, 75.0, "angle of the front face")
    retention_deg: float = parameter(45.0, "°", 5.0, 80.0, "angle of the rear face, which sets the holding force")
    half_width: float = parameter(5e-3, "m", 1e-3, 30e-3, "distance from centre to the edge that touches a hook")
    clearance: float = parameter(0.0, "m", 0.0, 2e-3, "gap between the seated part and the straight beam")
    seat: float = parameter(5e3, "N/m", 0.0, 50e3, "stiffness of the socket's floor, per edge")
    edge: float = parameter(0.2e-3, "m", 0.02e-3, 1e-3, "half length of the rounded edges of the wedge")
    creep: float = parameter(5e-3, "m/s", 1e-4, 0.1, "speed below which friction is viscous")
    beam: Model = "timoshenko"
    material: str = "ABS"
    hooks: int = 2

    hook: Hook = field(init=False, repr=False, compare=False)
    _snap: Records = field(init=False, repr=False, compare=False)
    _table: Array = field(init=False, repr=False, compare=False)  #: (n, 12): cubics of Ω₊, Ω₋, Ωₓ over E w [m/N]

    def __post_init__(self) -> None:
        ObjectWorld.__post_init__(self)
        if self.hooks not in (1, 2):
            raise InputError(f"SnapFit.hooks must be 1 or 2; got {self.hooks!r}")
        hook = Hook(
            self.base_length, self.peak, self.thickness, self.height, self.width,
            math.radians(self.insertion_deg), math.radians(self.retention_deg),
            self.youngs_modulus, self.poisson_ratio, flat_top=True,
        )  # fmt: skip
        snap = np.zeros(1, dtype=_SNAP)
        snap["foot"], snap["top"], snap["peak"] = hook.base_length, hook.ramp_end, hook.peak
        snap["rear"], snap["front"] = math.tan(hook.rear), math.tan(hook.front)
        span = hook.tip - 0.5 * hook.base_length
        x = np.linspace(
            0.5 * hook.base_length,
            hook.tip,
            min(max(math.ceil(4 * span / self.edge), _MIN_TABLE_PLACES), _MAX_TABLE_PLACES),
        )
        snap["half"], snap["start"], snap["step"] = self.half_width, x[0], x[1] - x[0]
        for name in ("edge", "friction", "creep", "clearance", "seat", "hooks"):
            snap[name] = getattr(self, name)
        rounded = hook.thickness + np.array([max(_wedge(place, snap[0])[0], 0.0) for place in x.tolist()])
        soft = compliance(hook, x, self.beam, surface=rounded)
        stiff, step = hook.youngs_modulus * hook.width, float(x[1] - x[0])
        table = np.concatenate([cubic_spline(each / stiff, step) for each in soft], axis=1)
        places = np.linspace(hook.base_length, hook.tip, 4 * len(table))
        depths = [share * hook.height - self.clearance for share in (0.0, 0.25, 0.5, 1.0, 2.0)]
        snap["springs"] = any(_springs(places, depth, snap, table) for depth in depths)
        values = {"hook": hook, "_snap": snap, "_table": table}
        for name, value in values.items():
            object.__setattr__(self, name, value)
        self._check_slides()

    def _check_slides(self) -> None:
        hook, lean = self.hook, math.atan(self.friction)
        front = np.linspace(hook.peak, hook.tip, 65)[:-1]  # at the tip itself the hook is not bent
        try:
            balance_face(hook, front, hook.section(front) - hook.thickness, -hook.front, -self.friction, self.beam)
        except GeometryError as cause:
            raise GeometryError(
                f"the hook cannot be pushed in, it jams: insertion_deg {self.insertion_deg:.4g}°, the turn of the face "
                f"by the bending and friction ({math.degrees(lean):.1f}°) are too steep together for this beam "
                f"({self.beam}). Reduce insertion_deg or friction"
            ) from cause
        if hook.rear + lean >= math.radians(89.0):
            locks = " (μ tan β ≥ 1: self-locking)" if self.friction * math.tan(hook.rear) >= 1.0 else ""
            raise GeometryError(
                f"the hook cannot be pulled out, it locks{locks}: retention_deg {self.retention_deg:.4g}° and friction "
                f"({math.degrees(lean):.1f}°) must stay below 89° together"
            )

    @classmethod
    def of(cls, hook: Hook, friction: float, beam: Model = "timoshenko", **others: Any) -> SnapFit:
        """Make a snap-fit with a given hook.

        Parameters
        ----------
        hook : Hook
            The hook, with `youngs_modulus`, `poisson_ratio`, lengths and angles of the world.
        friction : float
            Coefficient μ between hook and part [1], from 0 to 1.
        beam : {"timoshenko", "paper"}
            Model of the hook.
        **others : object
            Other parameters of the world, as in the constructor.

        Returns
        -------
        SnapFit
            The world.

        Raises
        ------
        GeometryError
            For a hook that cannot exist, cannot be pushed in or cannot be pulled out.
        """
        return cls(
            youngs_modulus=hook.youngs_modulus, poisson_ratio=hook.poisson_ratio, friction=friction,
            base_length=hook.base_length, peak=hook.peak, thickness=hook.thickness, height=hook.height,
            width=hook.width, insertion_deg=round(math.degrees(hook.front), 9),
            retention_deg=round(math.degrees(hook.rear), 9),
            beam=beam, **others,
        )  # fmt: skip

    @property
    def root_load(self) -> RootLoad:
        """Load at the root of a hook at its largest deflection: at the nearer end of the top, or on the rear face."""
        places = np.linspace(self.hook.base_length, self.hook.peak, 65)[1:]
        bent = np.maximum(self.hook.section(places) - self.hook.thickness - self.clearance, 0.0)
        return compute_root_load(self.hook, places, bent, compliance(self.hook, places, self.beam).plus, self.material)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Strain and stress at the hooks' root."""
        return (self.root_load.sentence,)

    def render_contacts(self, state: State) -> tuple[Array, Array]:
        """(6,) wrench, and (2, 8) contacts of the hooks, the one at +Y' first: see `ContactWorld`."""
        wrench, hooks = np.empty(6), np.zeros((2, 8))
        one = np.ascontiguousarray  # one memory layout: one compilation
        _snap_fit(
            one(state.p), one(state.R_SR), one(state.v), one(state.w), self._snap, self._table,
            np.empty(1, _TOUCH), wrench, view_contacts(hooks),
        )  # fmt: skip
        return wrench, hooks

    def contacts(self, state: State) -> tuple[HookContact, ...]:
        """Compute the contact of each hook.

        Parameters
        ----------
        state : State
            State of the object.

        Returns
        -------
        tuple of HookContact
            Contact of each hook, the one at +Y' first.
        """
        found = []
        for bent, place, *rest in self.render_contacts(state)[1][: self.hooks].tolist():
            face = "" if bent == 0.0 else "rear" if place < self.hook.ramp_end else "top"
            if bent > 0.0 and place > self.hook.peak:
                face = "front"
            found.append(HookContact(face, np.array(rest[:3]), np.array(rest[3:]), bent, place))
        return tuple(found)


# --------------------------------------------------------------------------------------------------
# Plug in an outlet: a flat plug between two hooks of the socket, pulled, tilted and moved back and forth.
#
# Frame: X' points out of the socket, Y' from one hook to the other; `state` is the pose of o', the middle of the plug's
# inner end, which is at the origin when the plug is fully inserted. The hooks touch at X' = arm. Rotated by θ about Z'
# the plug's faces cross X' = arm at Y' = p_y + (arm − p_x) tan θ ± w_p/(2 cos θ), and each hook is bent by the excess
# over half the opening: eqs. (14)–(16) of Bai 2012, with p_x = x₀ + x (tilted at the floor, one corner touches and o'
# is x₀ = (w_p/2) sin θ off) and ε_z = −θ. The other sign of ε_z in (16) against y, and against T_Z' in (18), gives a
# torque that increases the tilt of a tilted plug: (16)–(18) are consistent with each other, and with energy, only if
# ε_z is positive clockwise about Z'.
#
# Two worlds:
#
# `Outlet`            conserves energy, for rendering: forces are the gradient of ½ Σ k δ² and friction opposes
#                     sliding. In addition to (17) it has the part of F_X' from a tilted face (F_Y' tan ε_z), the torque
#                     of the plug's increasing width with tilt, and the couple of friction. A bevelled end, so that the
#                     plug can be removed and inserted.
# `PublishedOutlet`   (14)–(18) as corrected (E9, E10, signs), for comparison with the paper's Fig. 8. It is not a
#                     gradient: a small closed loop can generate energy, so it is marked not passive.


#: Settings of the kernel of an outlet.
_PLUG = fields(
    ("half", "f8"),  # half width of the plug [m]
    ("lead", "f8"), ("slope", "f8"),  # length of its bevelled end [m], and its slope
    ("edge", "f8"),  # half length of the rounding between bevel and full width [m]
    ("stiffness", "f8"), ("recoil", "f8"),  # of a hook: [N/m] and Ω₋/Ω₊
    ("friction", "f8"), ("creep", "f8"),  # μ, and the speed below which it is viscous [m/s]
    ("arm", "f8"),  # from the plug's inner end to the hooks when it is fully inserted [m]
    ("opening", "f8"),  # between the hooks [m]
    ("seat", "f8"),  # [N/m]
    ("peak", "f8"),  # position of the contact along the hook [m]
)  # fmt: skip


@kernel
def _face(along: float, plug: Record) -> tuple[float, float]:
    """Half width of the plug at `along` from its inner end, and its slope: a lead-in, then the full width."""
    half, slope, edge = plug.half, plug.slope, plug.edge
    u = plug.lead - along
    if u >= edge:
        return half - slope * u, slope
    if u <= -edge:
        return half, 0.0
    return half - slope * (u + edge) ** 2 / (4.0 * edge), slope * (u + edge) / (2.0 * edge)


@tick_kernel
def _outlet(p: Array, R: Array, v: Array, w: Array, plugs: Records, wrench: Array, contacts: Records) -> None:
    """Fill wrench (6,) on the plug about o', and contacts (2,) CONTACT, zero on input. plugs is (1,) _PLUG."""
    plug = plugs[0]
    arm, opening, seat, stiffness = plug.arm, plug.opening, plug.seat, plug.stiffness
    recoil, friction, creep = plug.recoil, plug.friction, plug.creep
    for i in range(6):
        wrench[i] = 0.0
    for hook in range(2):
        contacts[hook].place = plug.peak
    if R[0, 0] < 0.5 or R[1, 1] < 0.5:  # rotated by more than 60°: such a plug cannot be in the socket
        return
    for hook in range(2):
        contact, side = contacts[hook], 1.0 if hook == 0 else -1.0
        along = (arm - p[0]) / R[0, 0]
        width, slope = _face(along, plug)
        for _ in range(30):  # intersection of the plug's face with X' = arm
            gap = p[0] + R[0, 0] * along + R[0, 1] * side * width - arm
            new = along - gap / (R[0, 0] + R[0, 1] * side * slope)
            if abs(new - along) < 1e-15:
                break
            along = new
            width, slope = _face(along, plug)
        a, b = along, side * width
        rx = R[0, 0] * a + R[0, 1] * b
        ry = R[1, 0] * a + R[1, 1] * b
        rz = R[2, 0] * a + R[2, 1] * b
        bent = side * (p[1] + ry) - 0.5 * opening  # Eq. (15a): remaining opening
        gx, gy, gz = 0.0, 0.0, 0.0
        if bent > 0.0:
            tx = R[0, 0] + R[0, 1] * side * slope  # along the face, in the X'Y' plane
            ty = R[1, 0] + R[1, 1] * side * slope
            fy = stiffness * bent  # in the opening direction of this hook
            fx = -side * fy * ty / tx  # the face's force is normal to it
            vx = v[0] + w[1] * rz - w[2] * ry
            vy = side * (v[1] + w[2] * rx - w[0] * rz)
            vz = v[2] + w[0] * ry - w[1] * rx
            gx, gy, gz = sliding_push(fx, fy, recoil, vx, vy, vz, friction, creep)
        contact.force[0], contact.force[1], contact.force[2] = -gx, -side * gy, -gz
        add_contact(contact, wrench, p, rx, ry, rz)
        contact.deflection = max(bent, 0.0)
        # floor under this corner of the plug's inner end
        tip, _ = _face(0.0, plug)
        cx, cy, cz = R[0, 1] * side * tip, R[1, 1] * side * tip, R[2, 1] * side * tip
        below = -(p[0] + cx)
        if below > 0.0:
            push = seat * below
            wrench[0] += push
            wrench[4] += cz * push
            wrench[5] -= cy * push


@dataclass(frozen=True)
class Outlet(ContactWorld, ObjectWorld):
    """Plug in an outlet: retained by friction, resists tilt, and is released at the end.

    Dimensions and materials of Bai 2012, Table 3, with E = 113 GPa (erratum E7). The pull is 11.5 N with the
    correct beam (`timoshenko`, E11) and 49.6 N with the paper's (`paper`, appendix B with H_x corrected, E9).

    Parameters
    ----------
    beam : {"timoshenko", "paper"}
        Model of the hooks: the correct beam, or appendix B of the paper with H_x corrected.
    material : str
        Material of the hooks, a name of `haptorb.beams.MATERIALS` for the yield strength in `root_load`; it changes no
        force. With another name the yield strength is unknown.

    Examples
    --------
    >>> out = State.at((0.001, 0, 0), R_SR=np.eye(3), v=(1.0, 0, 0))
    >>> Outlet().wrench(out)[0].round(1), Outlet(beam="paper").wrench(out)[0].round(1)
    (np.float64(-11.5), np.float64(-49.6))
    """

    youngs_modulus: float = parameter(113e9, "Pa", 1e9, 250e9, "E of the socket's hooks")
    poisson_ratio: float = parameter(0.41, "", 0.0, 0.49, "ν of the socket's hooks")
    friction: float = parameter(0.134, "", 0.0, 1.0, "μ between plug and hooks")
    base_length: float = parameter(5.4e-3, "m", 2e-3, 40e-3, "hook: length from root to foot of the rear face")
    peak: float = parameter(9.6e-3, "m", 3e-3, 50e-3, "hook: length from root to the top that touches the plug")
    thickness: float = parameter(0.6e-3, "m", 0.2e-3, 5e-3, "hook: thickness of the beam")
    height: float = parameter(1.8e-3, "m", 0.2e-3, 5e-3, "hook: height of the wedge")
    width: float = parameter(8e-3, "m", 1e-3, 30e-3, "hook: width")
    retention_deg: float = parameter(58.8, "°", 5.0, 85.0, "hook: angle of the rear face, which never touches the plug")
    plug_width: float = parameter(6.3e-3, "m", 1e-3, 30e-3, "w_p: width of the plug across the hooks")
    opening: float = parameter(4.8e-3, "m", 0.5e-3, 30e-3, "w_s: gap between the hooks without the plug")
    # h is not given (assumed): blades of 6.3 mm × 1.5 mm are those of a two-pin flat plug, 15.9–18.3 mm long
    arm: float = parameter(16e-3, "m", 5e-3, 40e-3, "h: distance from the inserted plug's inner end to the hooks")
    # assumed: the paper's plug has no end; a real one is bevelled, otherwise it could not be inserted
    lead_in: float = parameter(4e-3, "m", 0.5e-3, 10e-3, "length of the bevelled end of the plug")
    seat: float = parameter(5e3, "N/m", 0.0, 50e3, "stiffness of the socket's floor, per corner")
    creep: float = parameter(5e-3, "m/s", 1e-4, 0.1, "speed below which friction is viscous")
    beam: Model = "timoshenko"
    material: str = "phosphor bronze"

    hook: Hook = field(init=False, repr=False, compare=False)
    stiffness: float = field(init=False, repr=False, compare=False)  #: of one hook, pulled straight, no friction [N/m]
    recoil: float = field(init=False, repr=False, compare=False)  #: Ω₋/Ω₊: outward motion of the top per bending
    _plug: Records = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        ObjectWorld.__post_init__(self)
        if self.opening >= self.plug_width:
            raise GeometryError(
                f"Outlet: the plug ({self.plug_width * 1e3:.4g} mm) is not wider than the opening "
                f"({self.opening * 1e3:.4g} mm): nothing would hold it"
            )
        if self.lead_in >= self.arm:
            raise GeometryError(
                f"Outlet: the plug's bevelled end ({self.lead_in * 1e3:.4g} mm) must be shorter than arm "
                f"({self.arm * 1e3:.4g} mm): the plug would come out before it is fully inserted"
            )
        hook = Hook(
            self.base_length, self.peak, self.thickness, self.height, self.width,
            TABLE_3.front, math.radians(self.retention_deg), self.youngs_modulus, self.poisson_ratio, flat_top=True,
        )  # fmt: skip
        if self.beam == "paper":
            soft = appendix_b(hook)
            plus, minus = soft.plus, soft.minus
        else:
            bent = compliance(hook, hook.peak, self.beam)
            plus, minus = float(bent.plus), float(bent.minus)
        if self.friction * minus / plus >= 1.0:
            raise GeometryError(
                f"Outlet: with friction {self.friction:g} this hook jams: pushing the plug in pulls the hooks tighter "
                f"(μ Ω₋/Ω₊ = {self.friction * minus / plus:.2f}, must be below 1)"
            )
        # the inner end is slightly narrower than the opening, so that it can be inserted
        drop = 0.5 * (self.plug_width - self.opening) + 0.1e-3
        edge = 0.25 * self.lead_in
        stiffness = self.youngs_modulus * self.width / plus
        plug = np.zeros(1, dtype=_PLUG)
        plug["half"], plug["lead"] = 0.5 * self.plug_width, self.lead_in
        plug["slope"], plug["edge"] = drop / self.lead_in, edge
        plug["stiffness"], plug["recoil"], plug["peak"] = stiffness, minus / plus, hook.peak
        for name in ("friction", "creep", "arm", "opening", "seat"):
            plug[name] = getattr(self, name)
        values = {"hook": hook, "stiffness": stiffness, "recoil": minus / plus, "_plug": plug}
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, hook: Hook, friction: float, beam: Model = "timoshenko", **others: Any) -> Outlet:
        """Make an outlet with a pair of a given hook.

        Parameters
        ----------
        hook : Hook
            The hook, with `youngs_modulus`, `poisson_ratio`, lengths and angles of the world.
        friction : float
            Coefficient μ between hook and part [1], from 0 to 1.
        beam : {"timoshenko", "paper"}
            Model of the hook.
        **others : object
            Other parameters of the world, as in the constructor.

        Returns
        -------
        Outlet
            The world.

        Raises
        ------
        GeometryError
            For a hook that cannot exist or jams, and a plug that would not be held.
        """
        return cls(
            youngs_modulus=hook.youngs_modulus, poisson_ratio=hook.poisson_ratio, friction=friction,
            base_length=hook.base_length, peak=hook.peak, thickness=hook.thickness, height=hook.height,
            width=hook.width, retention_deg=round(math.degrees(hook.rear), 9), beam=beam, **others,
        )  # fmt: skip

    @property
    def root_load(self) -> RootLoad:
        """Load at the root of a hook with the plug inserted straight, in contact at the end of the top."""
        bent = np.array([0.5 * (self.plug_width - self.opening)])
        plus = np.array([self.youngs_modulus * self.width / self.stiffness])
        return compute_root_load(self.hook, np.array([self.hook.peak]), bent, plus, self.material)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Strain and stress at the hooks' root."""
        return (self.root_load.sentence,)

    @property
    def outline(self) -> Array:
        """(8, 2) positions along the plug from its inner end to its full width, and its half width there [m]."""
        along = np.linspace(0.0, 1.25 * self.lead_in, 8)
        return np.array([(x, _face(x, self._plug[0])[0]) for x in along.tolist()])

    def render_contacts(self, state: State) -> tuple[Array, Array]:
        """(6,) wrench, and (2, 8) contacts of both hooks, the one at +Y' first: see `ContactWorld`."""
        wrench, hooks = np.empty(6), np.zeros((2, 8))
        one = np.ascontiguousarray  # one memory layout: one compilation
        _outlet(one(state.p), one(state.R_SR), one(state.v), one(state.w), self._plug, wrench, view_contacts(hooks))
        return wrench, hooks

    def contacts(self, state: State) -> tuple[HookContact, ...]:
        """Compute the contact of each hook.

        Parameters
        ----------
        state : State
            State of the object.

        Returns
        -------
        tuple of HookContact
            Contact of each hook, the one at +Y' first; it is always on its top.
        """
        return tuple(
            HookContact("top" if bent > 0 else "", np.array(rest[:3]), np.array(rest[3:]), bent, place)
            for bent, place, *rest in self.render_contacts(state)[1].tolist()
        )


# --------------------------------------------------------------------------------------------------
# Outlet of the paper, for comparison with its Fig. 8; use `Outlet` for rendering.


@dataclass(frozen=True)
class PublishedOutlet(ObjectWorld):
    """Bai 2012, eqs. (14)–(18) with errata corrected: the world of Fig. 8 (socket as in Table 3).

    Pulling: F_X' = −E w μ (w_p sec ε − w_s)/(Ω₊ + μΩ₋), F_Y' and T_Z' = F_Y' (h − p_x) as in (17), (18) with the
    missing factor (E10). F_X' is printed positive, the pull of the hand; on the plug it is the opposite. The plug ends
    abruptly at p_x = h. For insertion, friction reverses and Ω₊ − μΩ₋ replaces Ω₊ + μΩ₋, as in (10).

    Parameters
    ----------
    beam : {"paper", "timoshenko"}
        Model of the hooks: appendix B of the paper, or the correct beam.
    surface_height : {"corrected", "printed"}
        With `beam` "paper", the height H_x in appendix B: by eq. (13), or 1 + δ/h₀ as printed (E9).

    Examples
    --------
    >>> PublishedOutlet().wrench(State.at((0.001, 0, 0), R_SR=np.eye(3), v=(1.0, 0, 0))).round(1).tolist()
    [-49.6, 0.0, 0.0, 0.0, 0.0, 0.0]
    """

    passive: ClassVar[bool] = False
    continuous: ClassVar[bool] = False

    youngs_modulus: float = parameter(113e9, "Pa", 1e9, 250e9, "E of the socket's hooks")
    friction: float = parameter(0.134, "", 0.0, 1.0, "μ between plug and hooks")
    plug_width: float = parameter(6.3e-3, "m", 1e-3, 30e-3, "w_p: width of the plug across the hooks")
    opening: float = parameter(4.8e-3, "m", 0.5e-3, 30e-3, "w_s: gap between the hooks without the plug")
    arm: float = parameter(16e-3, "m", 5e-3, 40e-3, "h: distance from the inserted plug's end to the hooks (assumed)")
    creep: float = parameter(5e-3, "m/s", 1e-4, 0.1, "speed below which friction is viscous")
    beam: Model = "paper"
    surface_height: Literal["corrected", "printed"] = "corrected"

    _omega: tuple[float, float, float] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        ObjectWorld.__post_init__(self)
        if self.surface_height not in ("corrected", "printed"):
            raise InputError(f"surface_height must be 'corrected' or 'printed'; got {self.surface_height!r}")
        if self.beam == "paper":
            bent = None if self.surface_height == "corrected" else 0.5 * (self.plug_width - self.opening)
            soft = appendix_b(TABLE_3, deflection=bent)
            plus, minus = soft.plus, soft.minus
        else:
            right = compliance(TABLE_3, TABLE_3.peak, self.beam)
            plus, minus = float(right.plus), float(right.minus)
        omega = (plus, minus, self.youngs_modulus * TABLE_3.width)
        object.__setattr__(self, "_omega", omega)

    def wrench(self, state: State) -> Array:
        """(6,) on the plug, about o' [N, N·m]."""
        x, y, _ = state.p
        R = state.R_SR
        out = np.zeros(6)
        c = self.arm - x  # h − x₀ − x
        if c <= 0.0 or R[0, 0] < 0.5:
            return out
        tan = -R[1, 0] / R[0, 0]  # ε_z is positive clockwise about Z'
        sec = math.sqrt(1.0 + tan * tan)
        slide = state.v[0] / math.sqrt(state.v[0] ** 2 + self.creep**2)
        plus, minus, stiff = self._omega
        stiffness = stiff / (plus + self.friction * slide * minus)
        half = 0.5 * self.plug_width * sec
        f_1 = stiffness * max(half + c * tan - 0.5 * self.opening - y, 0.0)  # (15), (16)
        f_2 = stiffness * max(half - c * tan - 0.5 * self.opening + y, 0.0)
        out[0] = -self.friction * slide * (f_1 + f_2)  # (17), on the plug
        out[1] = f_1 - f_2
        out[5] = out[1] * c  # (18) with (17)'s factor (E10)
        return out
