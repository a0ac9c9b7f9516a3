"""A plug in an outlet: a flat plug between two hooks of the socket, pulled, tilted and moved back and forth.

Frame: X' points out of the socket, Y' from one hook to the other; `state` is the pose of o', the middle of the
plug's inner end, which is at the origin when the plug is fully inserted. The hooks touch at X' = arm. Turned by θ about
Z' the plug's faces cross X' = arm at Y' = p_y + (arm − p_x) tan θ ± w_p/(2 cos θ), and each hook is bent by the excess
over half the opening: eqs. (14)–(16) of Bai 2012, with p_x = x₀ + x (tilted at the floor, one corner touches and o'
stands x₀ = (w_p/2) sin θ off) and ε_z = −θ. The other sign of ε_z in (16) against y, and against T_Z' in (18), makes a
torque that turns a tilted plug further: (16)–(18) hold together, and with energy, only if ε_z counts clockwise about
Z'.

Two worlds:

`Outlet`            conserves energy, for rendering: forces are the gradient of ½ Σ k δ² and friction opposes
                    sliding. Against (17) it has the part of F_X' that a tilted face must push (F_Y' tan ε_z), the
                    torque of the plug getting wider by tilting, and friction's couple. A bevelled end, so that the plug
                    comes out and can be put back.
`PublishedOutlet`   (14)–(18) as corrected (E9, E10, signs), for comparison with the paper's Fig. 8. It is not a
                    gradient: a small closed loop can deliver energy, so it is marked not passive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from haptorb.devices.state import State
from haptorb.errors import GeometryError
from haptorb.numerics.arrays import Array, Record, Records, fields
from haptorb.numerics.compiled import kernel, tick_kernel
from haptorb.physics.beams import Model, appendix_b, compliance
from haptorb.physics.hook import TABLE_3, Hook
from haptorb.worlds.contact_world import ContactWorld
from haptorb.worlds.parameter import parameter
from haptorb.worlds.snap_fit.hook_contact import HookContact, add_contact, view_contacts
from haptorb.worlds.snap_fit.root_load import RootLoad, compute_root_load
from haptorb.worlds.snap_fit.sliding import sliding_push
from haptorb.worlds.world import TargetWorld

__all__ = ["Outlet"]


#: What the kernel of an outlet goes by.
_PLUG = fields(
    ("half", "f8"),  # width of the plug, halved [m]
    ("lead", "f8"), ("slope", "f8"),  # length of its bevelled end [m], and how steep it is
    ("edge", "f8"),  # half length of the rounding between bevel and full width [m]
    ("stiffness", "f8"), ("recoil", "f8"),  # of a hook: [N/m] and Ω₋/Ω₊
    ("friction", "f8"), ("creep", "f8"),  # μ, and the speed below which it is viscous [m/s]
    ("arm", "f8"),  # from the plug's inner end to the hooks when it is home [m]
    ("opening", "f8"),  # between the hooks [m]
    ("seat", "f8"),  # [N/m]
    ("peak", "f8"),  # place along the hook that touches [m]
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
    """Fill wrench (6,) on the plug about o', and contacts (2,) CONTACT, which are zero before. plugs is (1,) _PLUG."""
    plug = plugs[0]
    arm, opening, seat, stiffness = plug.arm, plug.opening, plug.seat, plug.stiffness
    recoil, friction, creep = plug.recoil, plug.friction, plug.creep
    for i in range(6):
        wrench[i] = 0.0
    for hook in range(2):
        contacts[hook].place = plug.peak
    if R[0, 0] < 0.5 or R[1, 1] < 0.5:  # turned by more than 60°: a plug that cannot be in the socket
        return
    for hook in range(2):
        contact, side = contacts[hook], 1.0 if hook == 0 else -1.0
        along = (arm - p[0]) / R[0, 0]
        width, slope = _face(along, plug)
        for _ in range(30):  # where the plug's face crosses X' = arm
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
        bent = side * (p[1] + ry) - 0.5 * opening  # Eq. (15a): what the face leaves of the opening
        gx, gy, gz = 0.0, 0.0, 0.0
        if bent > 0.0:
            tx = R[0, 0] + R[0, 1] * side * slope  # along the face, in the X'Y' plane
            ty = R[1, 0] + R[1, 1] * side * slope
            fy = stiffness * bent  # in the direction that opens this hook
            fx = -side * fy * ty / tx  # the face pushes at right angles to itself
            vx = v[0] + w[1] * rz - w[2] * ry
            vy = side * (v[1] + w[2] * rx - w[0] * rz)
            vz = v[2] + w[0] * ry - w[1] * rx
            gx, gy, gz = sliding_push(fx, fy, recoil, vx, vy, vz, friction, creep)
        contact.force[0], contact.force[1], contact.force[2] = -gx, -side * gy, -gz
        add_contact(contact, wrench, p, rx, ry, rz)
        contact.deflection = max(bent, 0.0)
        # the floor under this corner of the plug's inner end
        tip, _ = _face(0.0, plug)
        cx, cy, cz = R[0, 1] * side * tip, R[1, 1] * side * tip, R[2, 1] * side * tip
        below = -(p[0] + cx)
        if below > 0.0:
            push = seat * below
            wrench[0] += push
            wrench[4] += cz * push
            wrench[5] -= cy * push


@dataclass(frozen=True)
class Outlet(ContactWorld, TargetWorld):
    """Plug in an outlet: friction holds it, it resists tilt, and comes free at the end.

    Dimensions and materials of Bai 2012, Table 3, with E = 113 GPa (erratum E7). The pull is 11.5 N with the
    correct beam (`timoshenko`, E11) and 49.6 N with the paper's (`paper`, appendix B with H_x corrected, E9).

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
    # assumed: the paper's plug never ends; a real one is bevelled, else it could not be put in
    lead_in: float = parameter(4e-3, "m", 0.5e-3, 10e-3, "length of the bevelled end of the plug")
    seat: float = parameter(5e3, "N/m", 0.0, 50e3, "stiffness of the socket's floor, per corner")
    creep: float = parameter(5e-3, "m/s", 1e-4, 0.1, "speed below which friction is viscous")
    beam: Model = "timoshenko"  #: "paper" for appendix B
    material: str = "phosphor bronze"  #: of the hooks, whose yield strength the root's stress is compared with

    hook: Hook = field(init=False, repr=False, compare=False)
    stiffness: float = field(init=False, repr=False, compare=False)  #: of one hook, pulled straight, no friction [N/m]
    recoil: float = field(init=False, repr=False, compare=False)  #: Ω₋/Ω₊: how far the top moves out per bending
    _plug: Records = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        TargetWorld.__post_init__(self)
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
        # the inner end is a little narrower than the opening, so that it finds in
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
        """The outlet with a pair of a given `hook`; `others` as in the constructor."""
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
        """(6,) the wrench, and (2, 8) the contacts of both hooks, first the one at +Y': see `ContactWorld`."""
        wrench, hooks = np.empty(6), np.zeros((2, 8))
        one = np.ascontiguousarray  # one layout: one compilation
        _outlet(one(state.p), one(state.R_SR), one(state.v), one(state.w), self._plug, wrench, view_contacts(hooks))
        return wrench, hooks

    def contacts(self, state: State) -> tuple[HookContact, ...]:
        """State of each hook, first the one at +Y'; the contact is always on its top."""
        return tuple(
            HookContact("top" if bent > 0 else "", np.array(rest[:3]), np.array(rest[3:]), bent, place)
            for bent, place, *rest in self.render_contacts(state)[1].tolist()
        )
