"""A snap-fit: cantilever hooks and the part that slides over their wedges.

Frame: X' points out of the socket (pulling apart is +X'), Y' towards one hook; `state` is the pose of the part's
reference point o' (devices.State: p and R_SR in that frame), which is at the origin when the part is seated. Each
hook is touched by one edge of the part. Bai 2012, eqs. (10)–(13), Fig. 6.

The hand feels, during insertion: the front face, the top, then the snap; during removal: the rear face, the top,
and the release down the front. There is no memory: the position of the edge and its direction of sliding
determine the force.

The hook has one bending mode: its surface at the wedge moves by δ·(κ, 1), κ = Ω₋/Ω₊, which is eq. (10) as a
mechanism, and stores U = E w δ²/(2 Ω₊(x)). So without friction f_y = E w δ/(Ω₊ ± tan γ Ω₋) as in (10), and the
rotation of the face by the bending, arctan(δ/x) in (11), follows from Ω₊(x), as required for conservation of
energy. Edges are
rounded, so the force is continuous. Left out: tilt of the wedge across its width, inertia of the hook, wear.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from haptorb.devices.state import State
from haptorb.errors import GeometryError, InputError
from haptorb.numerics.arrays import Array, Record, Records, fields
from haptorb.numerics.compiled import kernel
from haptorb.numerics.cubic_spline import cubic_spline
from haptorb.physics.beams import Model, compliance
from haptorb.physics.hook import Hook
from haptorb.worlds.contact_world import ContactWorld
from haptorb.worlds.parameter import parameter
from haptorb.worlds.snap_fit.hook_contact import HookContact, add_contact, view_contacts
from haptorb.worlds.snap_fit.root_load import RootLoad, compute_root_load
from haptorb.worlds.snap_fit.sliding import sliding_push
from haptorb.worlds.world import TargetWorld

__all__ = ["SnapFit"]


#: What the kernel of a snap-fit goes by.
_SNAP = fields(
    ("foot", "f8"), ("top", "f8"),  # of the rear face: where it begins and ends, from the root [m]
    ("peak", "f8"),  # where the front face starts [m]
    ("rear", "f8"), ("front", "f8"),  # slopes of the two faces
    ("edge", "f8"),  # half length of the rounding [m]
    ("height", "f8"),  # of the wedge [m]
    ("recoil", "f8"),  # κ = Ω₋/Ω₊
    ("friction", "f8"), ("creep", "f8"),  # μ, and the speed below which it is viscous [m/s]
    ("half", "f8"),  # from the part's middle to its edge [m]
    ("clearance", "f8"),  # [m]
    ("seat", "f8"),  # [N/m]
    ("start", "f8"), ("step", "f8"),  # of the table of stiffnesses [m]
    ("hooks", "i8"),
)  # fmt: skip


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
    """Height of the wedge over the base beam at x, and its slope; the front runs on over the tip's end."""
    a, da = _round_corner(x - snap.foot, snap.edge)
    b, db = _round_corner(x - snap.top, snap.edge)
    c, dc = _round_corner(x - snap.peak, snap.edge)
    return snap.rear * (a - b) - snap.front * c, snap.rear * (da - db) - snap.front * dc


@kernel
def _stiffness(x: float, start: float, step: float, spline: Array) -> tuple[float, float]:
    """E w/Ω₊ at x [N/m] and its slope, from the table; constant beyond its ends."""
    count = spline.shape[0]
    u = (x - start) / step
    if u <= 0.0:
        return spline[0, 3], 0.0
    if u >= count:
        s = step
        last = count - 1
        return ((spline[last, 0] * s + spline[last, 1]) * s + spline[last, 2]) * s + spline[last, 3], 0.0
    i = int(u)
    s = x - (start + i * step)
    a, b, c, d = spline[i, 0], spline[i, 1], spline[i, 2], spline[i, 3]
    return ((a * s + b) * s + c) * s + d, (3.0 * a * s + 2.0 * b) * s + c


@kernel
def _find_contact(X: float, Y: float, snap: Record) -> float:
    """The place x on the hook that an edge at (X, Y) touches: x + κ δ(x) = X with δ = max(0, height(x) + Y)."""
    high, recoil = X, snap.recoil
    low = X - recoil * max(0.0, snap.height + Y)
    x = X
    for _ in range(60):
        H, dH = _wedge(x, snap)
        gap = x - X
        slope = 1.0
        if H + Y > 0.0:
            gap += recoil * (H + Y)
            slope += recoil * dH
        if abs(gap) < 1e-15:
            break
        if gap > 0.0:
            high = x
        else:
            low = x
        new = x - gap / slope if slope > 1e-3 else 0.5 * (low + high)
        if not low <= new <= high:
            new = 0.5 * (low + high)
        if new == x:
            break
        x = new
    return x


@kernel
def _snap_fit(
    p: Array, R: Array, v: Array, w: Array, snaps: Records, spline: Array, wrench: Array, contacts: Records
) -> None:
    """Fill wrench (6,) on the part about o', and contacts (2,) CONTACT, which are zero before.

    snaps is (1,) _SNAP, spline the table of the hook's stiffness.
    """
    snap = snaps[0]
    half, clearance, foot, seat = snap.half, snap.clearance, snap.foot, snap.seat
    recoil, friction, creep = snap.recoil, snap.friction, snap.creep
    for i in range(6):
        wrench[i] = 0.0
    for hook in range(snap.hooks):
        contact, side = contacts[hook], 1.0 if hook == 0 else -1.0
        # the edge sits at (0, ±half, 0) of the part
        rx, ry, rz = R[0, 1] * side * half, R[1, 1] * side * half, R[2, 1] * side * half
        X = foot + p[0] + rx
        Y = side * (p[1] + ry) - half - clearance
        x = _find_contact(X, Y, snap)
        H, dH = _wedge(x, snap)
        bent = max(0.0, H + Y)
        gx, gy, gz = 0.0, 0.0, 0.0
        if bent > 0.0:
            K, dK = _stiffness(x, snap.start, snap.step, spline)
            share = 1.0 / (1.0 + recoil * dH)
            climb = 0.5 * dK * bent * bent
            fx = (K * bent * dH + climb) * share  # ∂U/∂X
            fy = (K * bent - recoil * climb) * share  # ∂U/∂Y
            along = (fy * recoil - fx) / (fx * recoil + fy)  # χ, the hook's own motion seen from the face
            vx = v[0] + w[1] * rz - w[2] * ry
            vy = side * (v[1] + w[2] * rx - w[0] * rz)
            vz = v[2] + w[0] * ry - w[1] * rx
            gx, gy, gz = sliding_push(fx, fy, along, vx, vy, vz, friction, creep)
        below = foot - X
        if below > 0.0:  # the seat
            gx -= seat * below
        contact.force[0], contact.force[1], contact.force[2] = -gx, -side * gy, -gz
        add_contact(contact, wrench, p, rx, ry, rz)
        contact.deflection, contact.place = bent, x


@dataclass(frozen=True)
class SnapFit(ContactWorld, TargetWorld):
    """Snap-fit: hooks bend, snap in, and hold until they are pulled out with enough force.

    Sizes as in `physics.Hook`. The default is a pair of ABS hooks of ordinary proportions (1.5 % strain at the
    root, about the limit of ABS in a joint that is opened often): a few newtons, which a motor of about 1 N·m renders
    through the modes without scaling. Raises GeometryError if the hook cannot exist, cannot be pushed in, or cannot be
    pulled out.

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
    beam: Model = "timoshenko"  #: "paper" for eqs. (12) and (13) as they stand
    material: str = "ABS"  #: whose yield strength the root's stress is compared with
    hooks: int = 2  #: 2: a pair that centres the part; 1: the part is pushed aside and wants a guide

    hook: Hook = field(init=False, repr=False, compare=False)
    _snap: Records = field(init=False, repr=False, compare=False)
    _spline: Array = field(init=False, repr=False, compare=False)  #: (256, 4): the four of a place beside each other

    def __post_init__(self) -> None:
        TargetWorld.__post_init__(self)
        if self.hooks not in (1, 2):
            raise InputError(f"SnapFit.hooks must be 1 or 2; got {self.hooks!r}")
        hook = Hook(
            self.base_length, self.peak, self.thickness, self.height, self.width,
            math.radians(self.insertion_deg), math.radians(self.retention_deg),
            self.youngs_modulus, self.poisson_ratio, flat_top=True,
        )  # fmt: skip
        x = np.linspace(0.5 * hook.base_length, hook.tip, 257)
        soft = compliance(hook, x, self.beam)
        top = compliance(hook, hook.peak, self.beam)
        recoil = float(top.minus / top.plus)
        spline = cubic_spline(hook.youngs_modulus * hook.width / soft.plus, float(x[1] - x[0]))
        snap = np.zeros(1, dtype=_SNAP)
        snap["foot"], snap["top"], snap["peak"] = hook.base_length, hook.ramp_end, hook.peak
        snap["rear"], snap["front"], snap["height"] = math.tan(hook.rear), math.tan(hook.front), hook.height
        snap["recoil"], snap["half"], snap["start"], snap["step"] = recoil, self.half_width, x[0], x[1] - x[0]
        for name in ("edge", "friction", "creep", "clearance", "seat", "hooks"):
            snap[name] = getattr(self, name)
        for name, value in {"hook": hook, "_snap": snap, "_spline": spline}.items():
            object.__setattr__(self, name, value)
        self._check_slides(x, spline, recoil)

    def _check_slides(self, x: Array, spline: Array, recoil: float) -> None:
        lean, hook = math.atan(self.friction), self.hook
        front = x[:-1] >= hook.peak  # at the tip itself nothing is bent
        bent = np.interp(x[:-1][front], [hook.peak, hook.tip], [hook.height, 0.0])
        stiffness, slope = spline[front, 3], spline[front, 2]
        steepest = float(np.arctan(math.tan(hook.front) - 0.5 * bent * slope / stiffness).max(initial=hook.front))
        limit = math.atan(1.0 / recoil) if recoil > 0 else math.pi / 2
        if steepest + lean >= limit:
            raise GeometryError(
                f"the hook cannot be pushed in, it jams: its front face, bent, leans {math.degrees(steepest):.1f}° and "
                f"friction adds {math.degrees(lean):.1f}°; this beam ({self.beam}) yields below "
                f"{math.degrees(limit):.1f}° together. Reduce insertion_deg or friction"
            )
        if hook.rear + lean >= math.radians(89.0):
            raise GeometryError(
                f"the hook cannot be pulled out, it locks: retention_deg {self.retention_deg:.4g}° and friction "
                f"({math.degrees(lean):.1f}°) must stay below 89° together"
            )

    @classmethod
    def of(cls, hook: Hook, friction: float, beam: Model = "timoshenko", **others: Any) -> SnapFit:
        """The world of a given `hook`; `others` as in the constructor."""
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
        """(6,) the wrench, and (2, 8) the contacts of the hooks, first the one at +Y': see `ContactWorld`."""
        wrench, hooks = np.empty(6), np.zeros((2, 8))
        one = np.ascontiguousarray  # one layout: one compilation
        _snap_fit(
            one(state.p), one(state.R_SR), one(state.v), one(state.w), self._snap, self._spline, wrench,
            view_contacts(hooks),
        )  # fmt: skip
        return wrench, hooks

    def contacts(self, state: State) -> tuple[HookContact, ...]:
        """State of each hook, first the one at +Y'."""
        found = []
        for bent, place, *rest in self.render_contacts(state)[1][: self.hooks].tolist():
            face = "" if bent == 0.0 else "rear" if place < self.hook.ramp_end else "top"
            if bent > 0.0 and place > self.hook.peak:
                face = "front"
            found.append(HookContact(face, np.array(rest[:3]), np.array(rest[3:]), bent, place))
        return tuple(found)
