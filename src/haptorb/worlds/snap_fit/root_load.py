"""Load at the root of a hook at its largest deflection, and whether its material yields."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptorb.numerics.arrays import Array
from haptorb.physics.beams import root_strain
from haptorb.physics.hook import Hook
from haptorb.physics.materials import MATERIALS

__all__ = ["RootLoad", "compute_root_load"]


@dataclass(frozen=True)
class RootLoad:
    """Largest bending strain and stress at the root during straight insertion and removal; linear, without friction.

    >>> RootLoad("ABS", 0.02, 46e6).sentence
    'root strain 2 %, stress 46 MPa: BEYOND YIELD of ABS (40 MPa), 1.15 times its yield strength'
    """

    material: str
    strain: float
    stress: float  #: E ε [Pa]
    stated_strength: float | None = None  #: yield strength that stands in for the table's [Pa]

    @property
    def yield_strength(self) -> float | None:
        """Of the named material [Pa]; None if the material is not in the table and none is stated."""
        if self.stated_strength is not None:
            return self.stated_strength
        known = MATERIALS.get(self.material)
        return None if known is None else known.yield_strength

    @property
    def margin(self) -> float | None:
        """Yield strength over stress: below 1 the hook stays bent. None if the yield strength is not known."""
        return None if self.yield_strength is None or self.stress <= 0.0 else self.yield_strength / self.stress

    @property
    def beyond_yield(self) -> bool:
        """Whether the stress exceeds the yield strength."""
        return self.margin is not None and self.margin < 1.0

    @property
    def sentence(self) -> str:
        """A summary in one line."""
        begin = f"root strain {100 * self.strain:.3g} %, stress {_megapascal(self.stress)}"
        if self.margin is None or self.yield_strength is None:
            return f"{begin}; the yield strength of '{self.material}' is not known (yield_strength in a design file)"
        of = f"{self.material} ({_megapascal(self.yield_strength)})"
        if self.beyond_yield:
            return f"{begin}: BEYOND YIELD of {of}, {1 / self.margin:.3g} times its yield strength"
        return f"{begin}: below the yield strength of {of} by a factor of {self.margin:.3g}"

    def numbers(self) -> dict[str, float | str | bool | None]:
        """As plain JSON types, SI, units in the names."""
        return {
            "material": self.material, "root_strain": self.strain, "root_stress_pa": self.stress,
            "yield_strength_pa": self.yield_strength, "yield_margin": self.margin, "beyond_yield": self.beyond_yield,
        }  # fmt: skip


def compute_root_load(hook: Hook, places: Array, deflections: Array, plus: Array, material: str) -> RootLoad:
    """The largest over contacts at `places` (n,) [m] from the root that bend `hook` by `deflections` (n,) [m], where
    its compliance is Ω₊ = `plus` (n,)."""
    strain = float(np.max(root_strain(hook, places, deflections, plus), initial=0.0))
    return RootLoad(material, strain, hook.youngs_modulus * strain)


def _megapascal(stress: float) -> str:
    return f"{stress / 1e6:.3g} MPa" if stress < 1e9 else f"{stress / 1e9:.3g} GPa"
