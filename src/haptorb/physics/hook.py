"""A cantilever hook of a snap-fit: its sizes, its angles, its material, and whether such a hook can exist.

Side view, x along the hook from its root, the wedge on the side that meets the other part:

      root ├────────── base_length ──┐  rear   peak  front
           │ thickness               └──/‾‾‾‾‾‾‾‾‾‾\\── tip        height is the wedge's, above the base beam

Insertion slides over the front face (angle α), pulling apart over the rear face (angle β), both measured from the
hook's length. Bai 2012, Fig. 6 and Table 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from haptorb.errors import GeometryError, InputError, quote
from haptorb.numerics.arrays import Array, check_finite

__all__ = ["METALS_FROM", "TABLE_3", "Hook"]

_LARGEST = 1e15  #: in SI units
METALS_FROM = 10e9  #: [Pa] no engineering metal is softer (lead: 16 GPa); what is, was probably misprinted


@dataclass(frozen=True)
class Hook:
    """Sizes [m], angles [rad], Young's modulus [Pa]; checked when made.

    Raises InputError for a number out of range, GeometryError for a wedge whose sizes contradict each other, saying by
    how much (erratum E8: β, h_b and ℓ_m − ℓ_b of Table 3 cannot all hold).

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
            if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _LARGEST:
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
        """Where the rear face reaches the wedge's height [m]: ℓ_b + h_b / tan β."""
        return min(self.base_length + self.height / math.tan(self.rear), self.peak)

    @property
    def tip(self) -> float:
        """ℓ_t, where the front face comes down to the base beam [m]."""
        return self.peak + self.height / math.tan(self.front)

    @property
    def shear_ratio(self) -> float:
        """E/G = 2 (1 + ν) of an isotropic material; (B.2c) prints 2.6, which is ν = 0.3 and not Table 3's 0.41."""
        return 2.0 * (1.0 + self.poisson_ratio)

    def ramp_to_peak(self) -> Hook:
        """The same hook with its rear face straight to the peak: the other way out of erratum E8.

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
        if self.ramp_end >= self.peak:  # no flat top: one knot less
            del knots[3], above[3]
        out: Array = self.thickness + np.interp(at, knots, above)
        return out

    def remarks(self, metal: bool) -> tuple[str, ...]:
        """Warnings about a hook that can exist; `metal` names its material.

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


#: The socket of Bai 2012, Table 3, with E = 113 GPa (erratum E7) and a flat top (E8). α is not given: 30° assumed, the
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
