"""Bending of a cantilever hook: published compliances (Bai 2012, eqs. 12–13, appendix B) and a corrected beam model.

All quantities are normalised as in the paper: Δ = δ/h₀, F = f/(E w h₀), lengths by h₀. A contact at x deflects the hook
sideways with f_y and pulls it along with f_x (tension positive); its deflection is

    Δ = Ω₊ F_y + Ω₋ F_x                                                                                       Eq. (10)

(the paper's s is the sign of that pull). In newtons and metres: f_y = E w δ / (Ω₊ + (f_x/f_y) Ω₋).

The contact also moves along the hook, by Ω₋ F_y + Ωₓ F_x (over h₀): with Ωₓ the three are the symmetric compliance of
an elastic body, so that the energy ½ fᵀ Ω f exists. Its change along the hook is the rotation of the face by both
forces.
Two models, one interface: `paper` is (12) and (13), which load the uniform part of the beam at its end ℓ_b wherever the
contact is; `timoshenko` loads the beam where the contact is (erratum E11: 4.8 times softer for Table 3). Small
deflections; a tapered part is a stack of slices, each bending as a uniform beam.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite, gauss_legendre
from haptorb.errors import GeometryError, InputError, UnknownName, quote

__all__ = [
    "MATERIALS",
    "METALS_FROM",
    "MODELS",
    "SHEAR_COEFFICIENT",
    "TABLE_3",
    "Appendix",
    "Compliance",
    "FaceForce",
    "Hook",
    "Material",
    "Model",
    "appendix_b",
    "balance_face",
    "compliance",
    "compute_bent_shape",
    "compute_handbook_force",
    "force_ratio",
    "root_strain",
]


# --------------------------------------------------------------------------------------------------
# Cantilever hook of a snap-fit: sizes, angles, material, and checks of its geometry.
#
# Side view, x along the hook from its root, the wedge on the side of the mating part:
#
#       root ├────────── base_length ──┐  rear   peak  front
#            │ thickness               └──/‾‾‾‾‾‾‾‾‾‾\── tip        height is the wedge's, above the base beam
#
# Insertion slides over the front face (angle α), removal over the rear face (angle β), both measured from the
# hook's length. Bai 2012, Fig. 6 and Table 3.


_MAX_NUMBER = 1e15  #: in SI units
_MIN_THICKNESS_RATIO = 1e-3  #: minimum thickness relative to the base length: beam theory does not apply below
METALS_FROM = 10e9  #: [Pa] lower limit of engineering metals (lead: 16 GPa); a lower value was probably misprinted


@dataclass(frozen=True)
class Hook:
    """Sizes [m], angles [rad], Young's modulus [Pa]; checked at construction.

    Raises InputError for a number out of range, GeometryError for inconsistent dimensions of the wedge, with the amount
    (erratum E8: β, h_b and ℓ_m − ℓ_b of Table 3 cannot all hold).

    >>> TABLE_3.ramp_end < TABLE_3.peak         # a flat top joins the ramp to the peak
    True
    """

    base_length: float  #: ℓ_b, root to the foot of the rear face [m]
    peak: float  #: ℓ_m, root to the start of the front face [m]
    thickness: float  #: h₀ of the base beam [m]
    height: float  #: h_b of the wedge above the base beam [m]
    width: float  #: w [m]
    front: float  #: α, insertion angle [rad]
    rear: float  #: β, retention angle [rad]
    youngs_modulus: float  #: E [Pa]
    poisson_ratio: float  #: ν
    flat_top: bool = False  #: a flat top may join the end of the rear face to the peak

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name == "flat_top":
                continue
            if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _MAX_NUMBER:
                raise InputError(f"hook.{item.name} must be a finite number; got {quote(value)}")
            if item.name != "poisson_ratio" and value <= 0.0:
                raise InputError(f"hook.{item.name} must be greater than zero; got {value:g}")
        if not 0.0 <= self.poisson_ratio < 0.5:
            raise InputError(
                f"hook.poisson_ratio must lie from 0 up to, not including, 0.5 (incompressible); "
                f"got {self.poisson_ratio:g}"
            )
        for name in ("front", "rear"):
            if getattr(self, name) >= math.pi / 2:
                raise InputError(
                    f"hook.{name} must be less than 90°: a vertical face cannot slide; "
                    f"got {math.degrees(getattr(self, name)):.4g}°"
                )
        if self.thickness < _MIN_THICKNESS_RATIO * self.base_length:
            raise GeometryError(
                f"hook.thickness ({self.thickness * 1e3:.3g} mm) is next to nothing: less than a thousandth of "
                f"hook.base_length ({self.base_length * 1e3:.4g} mm); a beam needs a cross-section"
            )
        if self.peak <= self.base_length:
            raise GeometryError(
                f"hook.peak ({self.peak * 1e3:.4g} mm) must lie beyond hook.base_length "
                f"({self.base_length * 1e3:.4g} mm): there is no room for the rear face"
            )
        self._check_ramp()

    def _check_ramp(self) -> None:
        room, needed = self.peak - self.base_length, self.height / math.tan(self.rear)
        reached = room * math.tan(self.rear)
        if abs(needed - room) <= 0.005 * room or (self.flat_top and needed < room):
            return
        beta, mm = math.degrees(self.rear), 1e3
        facts = (
            f"a rear face of {beta:.4g}° over {room * mm:.4g} mm rises {reached * mm:.4g} mm, but hook.height is "
            f"{self.height * mm:.4g} mm: {abs(reached - self.height) * mm:.4g} mm too "
        )
        ways = (
            f"set the rear angle to {math.degrees(math.atan(self.height / room)):.4g}°, or the peak to "
            f"{(self.base_length + needed) * mm:.4g} mm"
        )
        if needed > room:
            raise GeometryError(f"{facts}little; {ways}")
        flat = (room - needed) * mm
        raise GeometryError(f"{facts}much (erratum E8); {ways}, or allow a flat top of {flat:.4g} mm (flat_top)")

    @property
    def ramp_end(self) -> float:
        """End of the rear face at the wedge's height [m]: ℓ_b + h_b / tan β."""
        return min(self.base_length + self.height / math.tan(self.rear), self.peak)

    @property
    def tip(self) -> float:
        """ℓ_t, end of the front face on the base beam [m]."""
        return self.peak + self.height / math.tan(self.front)

    @property
    def shear_ratio(self) -> float:
        """E/G = 2 (1 + ν) of an isotropic material; (B.2c) prints 2.6, which is ν = 0.3 and not Table 3's 0.41."""
        return 2.0 * (1.0 + self.poisson_ratio)

    def ramp_to_peak(self) -> Hook:
        """The same hook with its rear face straight to the peak: the other resolution of erratum E8.

        >>> round(math.degrees(TABLE_3.ramp_to_peak().rear), 1)
        23.2
        """
        return replace(self, rear=math.atan(self.height / (self.peak - self.base_length)), flat_top=False)

    def section(self, x: ArrayLike) -> Array:
        """h(x), thickness of the hook at `x` (...) [m] from the root, same shape [m]; edges sharp.

        >>> (TABLE_3.section([0.0, 0.0054, 0.0096]) * 1e3).round(6).tolist()
        [0.6, 0.6, 2.4]
        """
        at = check_finite(x, "x")
        knots = [0.0, self.base_length, self.ramp_end, self.peak, self.tip]
        above = [0.0, 0.0, self.height, self.height, 0.0]
        if self.ramp_end >= self.peak:  # without a flat top: one knot less
            del knots[3], above[3]
        out: Array = self.thickness + np.interp(at, knots, above)
        return out

    def remarks(self, metal: bool) -> tuple[str, ...]:
        """Warnings about a feasible hook; `metal` names its material.

        >>> [remark[:14] for remark in replace(TABLE_3, youngs_modulus=1.13e9).remarks(metal=True)]
        ['youngs_modulus']
        """
        texts = []
        if metal and self.youngs_modulus < METALS_FROM:
            texts.append(
                f"youngs_modulus {self.youngs_modulus / 1e9:.4g} GPa is far too low for a metal (copper alloys: about "
                f"100 GPa). Bai 2012's Table 3 has this misprint (erratum E7: 1.13 GPa for 113 GPa)"
            )
        return tuple(texts)


#: Socket of Bai 2012, Table 3, with E = 113 GPa (erratum E7) and a flat top (E8). α is not given: 30° assumed, the
#: usual lead-in of a hook; the outlet never touches the front face.
TABLE_3 = Hook(
    base_length=5.4e-3,
    peak=9.6e-3,
    thickness=0.6e-3,
    height=1.8e-3,
    width=8e-3,
    front=math.radians(30.0),
    rear=math.radians(58.8),
    youngs_modulus=113e9,
    poisson_ratio=0.41,
    flat_top=True,
)


Model = Literal["paper", "timoshenko"]
MODELS: tuple[Model, ...] = ("paper", "timoshenko")
SHEAR_COEFFICIENT = 1.2  #: p of eq. (12): a rectangular section

_NODES, _WEIGHTS = gauss_legendre(40)


class Compliance(NamedTuple):
    """Dimensionless Ω₊, Ω₋ and Ωₓ at contact points, each of the shape of the points."""

    plus: Array  #: sideways, per sideways force
    minus: Array  #: sideways per pull, and along the hook per sideways force
    along: Array  #: along the hook, per pull


class Appendix(NamedTuple):
    """The five terms of appendix B, (B.3)–(B.5c), in the order printed."""

    plus_1: float
    plus_2: float
    plus_3: float
    minus_1: float
    minus_2: float

    @property
    def plus(self) -> float:
        """Ω₊, (B.1)."""
        return self.plus_1 + self.plus_2 + self.plus_3

    @property
    def minus(self) -> float:
        """Ω₋, (B.1)."""
        return self.minus_1 + self.minus_2


def appendix_b(hook: Hook, *, deflection: float | None = None, shear_ratio: float = 2.6) -> Appendix:
    """Closed forms of appendix B for contact on the top of `hook`.

    deflection    None: H_x = h(x)/h₀ − 1 as (13) demands (erratum E9). A deflection [m]: the printed H_x = 1 + δ/h₀.
    shear_ratio   E/G; (B.2c) prints 2.6

    The ramp ends at L_b + H_b/tan β (E8); a flat top beyond it is not counted, as printed.

    >>> from haptorb.beams import TABLE_3
    >>> [round(term, 2) for term in appendix_b(TABLE_3)]
    [2944.08, 299.16, 2.62, 3024.0, 95.39]
    """
    h0 = hook.thickness
    L_b, L_m, H_b, tan = hook.base_length / h0, hook.peak / h0, hook.height / h0, math.tan(hook.rear)
    rho = 1.0 / (1.0 + H_b)  # (B.2a)
    H_x = H_b if deflection is None else 1.0 + float(check_finite(deflection, "deflection")) / h0  # (13), or (B.2b)
    a = 1.0 - L_b * tan
    return Appendix(
        plus_1=4.0 * (1.0 + 0.3 / L_b**2 * shear_ratio) * L_b**3,  # (B.3)
        plus_2=6.0 / tan**3 * (-2.0 * math.log(rho) - 4.0 * H_b * rho * a + H_b * (2.0 + H_b) * a**2 * rho**2),  # (B.4)
        plus_3=-SHEAR_COEFFICIENT * shear_ratio * math.log(rho) / tan,  # (B.5a)
        minus_1=3.0 * L_m * (2.0 * H_x + 1.0) * L_b,  # (B.5b)
        minus_2=3.0 * L_m / (2.0 * tan) * (2.0 * H_x + 1.0) * (1.0 - rho**2),  # (B.5c)
    )


def _moments(hook: Hook, x: Array) -> Array:
    """(6, n): ∫₀ˣ of 12/h³, 12ξ/h³, 12ξ²/h³, 12/h², 12ξ/h², 1/h over the hook, normalised, edges sharp."""
    h0 = hook.thickness
    knots = np.array([0.0, hook.base_length, hook.ramp_end, hook.peak, hook.tip]) / h0
    total = np.zeros((6, len(x)))
    for start, end in pairwise(knots):  # within an interval the section is linear: Gauss quadrature is exact
        beyond, inside = x >= end, (x > start) & (x < end)
        half = 0.5 * (np.append(x[inside], end) - start)  # the last: the whole interval, for every point beyond it
        xi = start + half[:, None] * (1.0 + _NODES)
        h = hook.section(xi * h0) / h0
        bend, lever = 12.0 / h**3, 12.0 / h**2
        for row, value in enumerate((bend, bend * xi, bend * xi**2, lever, lever * xi, 1.0 / h)):
            parts = (value @ _WEIGHTS) * half
            total[row, inside] += parts[:-1]
            total[row, beyond] += parts[-1]
    return total


def compliance(
    hook: Hook,
    x: ArrayLike,
    model: Model = "timoshenko",
    *,
    shear_ratio: float | None = None,
    surface: ArrayLike | None = None,
) -> Compliance:
    """Ω₊, Ω₋ and Ωₓ of `hook` for a contact at `x` (...) [m] from the root, up to the tip.

    paper        (12) and (13) with the section as it is, flat top included; Ωₓ = Ω₋²/Ω₊, since the paper has none: the
                 hook as a mechanism with one motion
    timoshenko   bending and shear of the beam from the root to the contact; the pull acts at the wedge's surface, h(x)
                 above the back of the hook, about the middle h(ξ)/2 of each section ξ, and stretches it

    shear_ratio  E/G, else from Poisson's ratio
    surface      (...) [m] height of the contact above the hook's back, if its edges are rounded; else h(x)

    Raises UnknownName for a model, InputError for x off the hook.

    >>> from haptorb.beams import TABLE_3
    >>> round(float(compliance(TABLE_3.ramp_to_peak(), 9.6e-3, shear_ratio=2.6).plus))
    15490
    """
    if model not in MODELS:
        raise UnknownName("beam model", str(model), MODELS)
    at = check_finite(x, "x")
    h0 = hook.thickness
    if at.size and (at.min() < 0.0 or at.max() > hook.tip * (1 + 1e-9)):
        raise InputError(
            f"x must lie on the hook, 0 to {hook.tip * 1e3:.4g} mm; got {at.min():.4g} to {at.max():.4g} m"
        )
    X = np.ravel(at) / h0
    shear = SHEAR_COEFFICIENT * (hook.shear_ratio if shear_ratio is None else shear_ratio)
    b0, b1, b2, l0, l1, area = _moments(hook, X)
    h = hook.section(X * h0) / h0 if surface is None else np.ravel(check_finite(surface, "surface")) / h0
    if model == "timoshenko":
        plus = X * X * b0 - 2.0 * X * b1 + b2 + shear * area
        minus = h * (X * b0 - b1) - 0.5 * (X * l0 - l1)
        along = h * h * b0 - h * l0 + 4.0 * area  # 3 of the 4 by bending, 1 by elongation
    else:
        plus = b2 + shear * area  # Eq. (12): up to ℓ_b its integrand gives 4 X³, so one integral serves both terms
        minus = 6.0 * X * (h - 0.5) * b0 / 12.0  # Eq. (13)
        along = np.divide(minus**2, plus, out=np.zeros_like(plus), where=plus > 0.0)
    return Compliance(plus.reshape(at.shape), minus.reshape(at.shape), along.reshape(at.shape))


class FaceForce(NamedTuple):
    """Force of a bent hook at contact points on a sharp-edged face, each of the shape of the points."""

    pull: Array  #: f_x, along the hook, out of the socket positive [N]
    push: Array  #: f_y, the bending force [N]
    turn: Array  #: rotation of the face by the bending [rad]
    shift: Array  #: displacement of the contact along the hook by the bending [m]


def balance_face(
    hook: Hook, x: ArrayLike, deflection: ArrayLike, slope: float, friction: float, model: Model = "timoshenko"
) -> FaceForce:
    """Force of an edge on the surface of `hook` at `x` (...) [m] that bends it by `deflection` (...) [m].

    slope     of the face [rad], rising towards the tip positive: β on the rear face, −α on the front face
    friction  μ; positive for an edge that is pulled out, negative for one that is pushed in

    Direct balance of normal force and friction on the face as both forces rotate it: δ by (10), and as in (11) f_x/f_y
    = tan(slope − turn + arctan μ). The turn is that of the section, plus half the shear strain beside the load; with
    the paper's model it is the chord arctan(δ/x) of (11). Raises GeometryError where the hook jams or locks. >>> from
    haptorb.beams import TABLE_3

    >>> force = balance_face(TABLE_3, 9.6e-3, 0.75e-3, 0.0, 0.134)          # an edge on its top
    >>> round(float(force.pull / force.push), 4), round(math.tan(math.atan(0.134) - float(force.turn)), 4)
    (0.0294, 0.0294)
    """
    at, bent = np.broadcast_arrays(check_finite(x, "x"), check_finite(deflection, "deflection"))
    soft = compliance(hook, at, model)
    h0, stiff = hook.thickness, hook.youngs_modulus * hook.width
    X = np.ravel(at) / h0
    b0, b1, _, l0, _, _ = _moments(hook, X)
    h = hook.section(X * h0) / h0
    sideways = (X * b0 - b1 + 0.5 * SHEAR_COEFFICIENT * hook.shear_ratio / h).reshape(at.shape) / (stiff * h0)
    lengthways = (h * b0 - 0.5 * l0).reshape(at.shape) / (stiff * h0)
    lean, turn = slope + math.atan(friction), bent / at
    for _ in range(60):
        whole = soft.plus * np.cos(lean - turn) + soft.minus * np.sin(lean - turn)
        if not (whole > 1e-9 * soft.plus).all():
            raise GeometryError(
                f"the hook locks by itself: a face of {math.degrees(abs(slope)):.4g}° and friction "
                f"({math.degrees(abs(math.atan(friction))):.1f}°) let no force slide the edge over it"
            )
        size = stiff * bent / whole
        pull, push = size * np.sin(lean - turn), size * np.cos(lean - turn)
        turn, last = np.arctan(bent / at if model == "paper" else sideways * push + lengthways * pull), turn
        if np.abs(turn - last).max(initial=0.0) < 1e-13:
            break
    return FaceForce(pull, push, turn, (soft.minus * push + soft.along * pull) / stiff)


def root_strain(hook: Hook, x: ArrayLike, deflection: ArrayLike, plus: ArrayLike) -> Array:
    """Maximum bending strain at the root of `hook`, bent by `deflection` (...) [m] under a contact at `x` (...) [m].

    ε = 6 X Δ/Ω₊ with `plus` Ω₊ there: the moment F_y X at the root, where the beam has its full thickness h₀. The
    pull's moment, some 3 % with friction on a flat top, is left out.

    >>> from haptorb.beams import TABLE_3
    >>> float(root_strain(TABLE_3, TABLE_3.peak, 0.75e-3, compliance(TABLE_3, TABLE_3.peak).plus).round(5))
    0.00789
    """
    bent = check_finite(deflection, "deflection") / hook.thickness
    strain: Array = 6.0 * check_finite(x, "x") / hook.thickness * bent / check_finite(plus, "plus")
    return strain


def force_ratio(slope: ArrayLike, friction: float, loading: bool) -> Array:
    """f_x/f_y on a face of true angle `slope` (...) [rad], friction μ: tan(γ' ± arctan μ).                 Eq. (11)

    `loading` is sliding uphill, the hook bending further (insertion over the front face, pulling apart over the rear
    one): friction adds. Downhill it subtracts. Eq. (11) prints the minus for retention altogether: then pulling apart
    would take less work than the hook stores, so it holds for insertion snapping home, not for pulling apart.

    >>> float(force_ratio(0.0, 0.134, loading=True).round(3))        # dwelling: μ itself
    0.134
    """
    angle = math.atan(float(check_finite(friction, "friction")))
    out: Array = np.tan(check_finite(slope, "slope") + (angle if loading else -angle))
    return out


def compute_handbook_force(push: float, slope: float, friction: float) -> float:
    """P (μ + tan α)/(1 − μ tan α) [N], by design guides for snap-fits: the force along a face of angle `slope`.

    `push` is P, the sideways force that bends the hook, without any pull. The face does not turn. Raises GeometryError
    if the face locks by itself, where the formula has no finite positive value.

    >>> compute_handbook_force(1.0, math.radians(30.0), 0.3).__round__(3)
    1.061
    """
    steep = friction * math.tan(slope)
    if steep >= 1.0:
        raise GeometryError(
            f"self-locking: friction times the slope of the face, {friction:g} · tan {math.degrees(slope):.4g}° = "
            f"{steep:.3g}, is 1 or more: by the handbook's formula no force slides the part over it. Reduce the angle "
            f"below {math.degrees(math.atan(1.0 / friction)):.3g}°, or the friction"
        )
    return push * (friction + math.tan(slope)) / (1.0 - steep)


def compute_bent_shape(hook: Hook, x: float, deflection: float, points: int = 33) -> Array:
    """(points, 2): positions along the hook's base [m] and deflections [m], for `deflection` under a load at `x`.

    Timoshenko's shape (sideways load only), straight beyond the load: for drawing, and for reading off the slope.

    Raises InputError for a load off the hook.

    >>> from haptorb.beams import TABLE_3
    >>> shape = compute_bent_shape(TABLE_3, TABLE_3.tip, 1e-3)
    >>> shape[0].tolist(), bool(abs(shape[-1, 1] - 1e-3) < 1e-12)
    ([0.0, 0.0], True)
    """
    if not 0.0 < x <= hook.tip:
        raise InputError(f"x must lie on the hook, 0 to {hook.tip * 1e3:.4g} mm; got {x * 1e3:.4g} mm")
    h0 = hook.thickness
    at = np.linspace(0.0, hook.tip, points) / h0
    X, inside = x / h0, np.minimum(at, x / h0)
    shear = SHEAR_COEFFICIENT * hook.shear_ratio
    b0, b1, b2, _, _, area = _moments(hook, inside)
    # a unit load at X bends section s by ∫₀ˢ 12 (X − ξ)(s − ξ)/h³ dξ; beyond X the slope is constant
    bent = X * inside * b0 - (X + inside) * b1 + b2 + shear * area + (at - inside) * (X * b0 - b1)
    whole = compliance(hook, x, "timoshenko").plus
    return np.column_stack([at * h0, bent / whole * deflection])


# --------------------------------------------------------------------------------------------------
# Materials of hooks at 23 °C, each from the data sheet of one grade, for a first comparison of designs.
#
# The yield strength is that of tension: for metals the 0.2 % proof stress of the spring or hard temper used for hooks,
# for polymers the stress at yield in a short-term test (ISO 527). Polyamide absorbs water: "PA66" is dry as moulded,
# "PA66 conditioned" in equilibrium with air of 50 % humidity (ISO 1110). A polymer bent warm or for long has a lower
# strength. Poisson's ratio affects the shear contribution only.


#: share of the strain at yield, single short-term bending: DSM, "Maximum allowable short-term strain"
_SINGLE_USE_SHARE = 0.7
_REPEATED_USE_SHARE = 0.6  #: share of the permissible strain, for hooks that are opened often: the same guide
_MAX_LINEAR_STRAIN = 0.06  #: maximum permissible strain for which the linear beam is used


def _permit(strain_at_yield: float) -> float:
    """Return the permissible strain of a polymer from the strain at yield of its data sheet."""
    return round(min(_SINGLE_USE_SHARE * strain_at_yield, _MAX_LINEAR_STRAIN), 4)


def _sheet(name: str) -> str:
    """Describe the source of a polymer's values."""
    return (
        f"{name}; ν assumed; permissible strain: 70 % of the strain at yield (DSM, Maximum allowable short-term "
        "strain), at most 6 %"
    )


def _strip(name: str) -> str:
    """Describe the source of a metal's values."""
    return f"{name}; permissible strain: yield strength over modulus"


_PAPER = "E and ν: Bai 2012, table 3 with erratum E7"


class Material(NamedTuple):
    """Stiffness and strength of a hook's material."""

    youngs_modulus: float  #: E [Pa]
    poisson_ratio: float  #: ν
    metal: bool
    yield_strength: float  #: [Pa]
    permissible_strain: float  #: single short-term bending
    breaking_strain: float  #: in tension
    condition: str  #: temper of a metal, water in a polymer
    source: str

    @property
    def repeated_strain(self) -> float:
        """Permissible strain where the hook is opened often: 60 % of a polymer's, all of a metal's.

        >>> round(MATERIALS["PC"].repeated_strain, 4)
        0.0252
        """
        return self.permissible_strain * (1.0 if self.metal else _REPEATED_USE_SHARE)


MATERIALS = {
    "ABS": Material(
        2.3e9, 0.35, False, 44e6, _permit(0.024), 0.12, "takes up little water", _sheet("data sheet of Terluran GP-35")
    ),
    "PA66": Material(
        3.0e9, 0.39, False, 85e6, _permit(0.045), 0.30, "dry as moulded", _sheet("data sheet of Ultramid A3K")
    ),
    "PA66 conditioned": Material(
        1.1e9, 0.42, False, 50e6, _permit(0.20), 0.50, "23 °C, 50 % humidity", _sheet("data sheet of Ultramid A3K")
    ),
    "PC": Material(
        2.4e9, 0.37, False, 65e6, _permit(0.06), 0.50, "23 °C, 50 % humidity", _sheet("data sheet of Makrolon 2405")
    ),
    "POM": Material(
        2.85e9, 0.35, False, 64e6, _permit(0.09), 0.30, "takes up little water",
        _sheet("data sheet of Hostaform C 9021"),
    ),
    "PP": Material(
        1.34e9, 0.42, False, 33e6, _permit(0.12), 0.80, "takes up no water",
        _sheet("homopolymer: 195 and 4.8 ksi, 12 % at yield (technical data sheet, scribd.com/document/631126760); "
               "80 % at break (makeitfrom.com)"),
    ),
    "brass": Material(
        93e9, 0.35, True, 300e6, 0.0032, 0.08, "CuZn37, R410",
        _strip(f"{_PAPER} (the sheet: 99 to 115 GPa); strength and strain: KME's data sheet of CuZn37"),
    ),
    "phosphor bronze": Material(
        113e9, 0.41, True, 530e6, 0.0047, 0.05, "CuSn6, R560",
        _strip(f"{_PAPER} (the sheet: 118 GPa); strength and strain: Aurubis's data sheet of CuSn6"),
    ),
    "spring steel": Material(
        206e9, 0.29, True, 1.2e9, 0.0058, 0.06, "C67S, quenched and tempered",
        _strip("least strength: Saarstahl's data sheet of C67S; E, ν and the strain at break assumed"),
    ),
    "PA6": Material(
        2.8e9, 0.39, False, 75e6, 0.03, 0.10, "dry as moulded",
        "assumed, for files made before PA66 was in this table: no data sheet was read",
    ),
    "PA6 conditioned": Material(
        1.1e9, 0.42, False, 45e6, 0.06, 0.50, "23 °C, 50 % humidity",
        "assumed, for files made before PA66 was in this table: no data sheet was read",
    ),
}  # fmt: skip
