"""Force of a coil array on its tool, in the worst direction and place of the workspace, by the array's exact map.

The tool is upright over a plate and radial over a dome, at `height` of the design file's table [evaluation] above
contact. The forces {K i} of currents within their limits and the supply's power are a convex set about zero; its
greatest ball has the radius min over unit vectors n of max n·K i. The minimum is at the normal of a facet (a product of
two columns of K), at a main axis of K R⁻¹ Kᵀ, or between them: directions all around and a search downhill find that.
"""

from __future__ import annotations

import numpy as np

from haptorb.design.candidate import DesignCandidate
from haptorb.design.objectives.registry import option
from haptorb.devices.coil_array.coil_array import CoilArray
from haptorb.devices.device import require
from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.numerics.directions import cap_directions

__all__ = [
    "array_of", "find_continuous", "find_heat", "find_heaviest", "find_isotropy", "find_peak", "find_pull",
    "greatest_force",
]  # fmt: skip

_PLACES = 40
_RIM = 12  #: places on the rim of a dome's workspace, where arrays are weakest
_AROUND = 60  #: directions that are tried at every place, on a half of the sphere
_ROUNDS = 5  #: of the search downhill


def array_of(candidate: DesignCandidate) -> CoilArray:
    """The candidate's device; InputError if it is no coil array."""
    return require(candidate.device, CoilArray, "this quantity")


def _list_states(candidate: DesignCandidate) -> list[State]:
    device, count = array_of(candidate), int(option(candidate, "places", _PLACES))
    surface = device.surface
    height = option(candidate, "height", 1.0) if "height" in candidate.options else 0.0
    far = device.contact_height + height
    if surface.is_dome:
        turns = 2 * np.pi * np.arange(_RIM) / _RIM
        sine, cosine = np.sin(surface.half_angle), np.cos(surface.half_angle)
        rim = np.column_stack([sine * np.cos(turns), sine * np.sin(turns), np.full(_RIM, cosine)])
        return [State.at(far * place) for place in (*cap_directions(surface.half_angle, count), *rim)]
    side = max(int(np.sqrt(count)), 2)
    across = [np.linspace(-half, half, side) for half in surface.half_width]
    return [State.at((x, y, far), axis=(0.0, 0.0, 1.0)) for x in across[0] for y in across[1]]


def _maps(candidate: DesignCandidate) -> tuple[Array, Array]:
    """(n, 3, m) force per ampere [N/A] and (n, 3) force without current [N] at the n places."""

    def compute() -> tuple[Array, Array]:
        device = array_of(candidate)
        maps = [device.wrench_map(state, "exact") for state in _list_states(candidate)]
        return np.stack([one.force for one in maps]), np.stack([one.passive[:3] for one in maps])

    return candidate.share("array: maps", compute)


def find_heaviest(candidate: DesignCandidate) -> tuple[float, Array]:
    """Greatest of the least heats for a force [W/N²] at the reference temperature, and the squares (m,) of the currents
    [A²/N²] that make it: in the worst direction and place; infinite where a direction has no force."""
    K, resistance = _maps(candidate)[0], array_of(candidate).coils.resistance
    values, axes = np.linalg.eigh((K / resistance) @ K.transpose(0, 2, 1))
    worst = int(np.argmin(values[:, 0]))
    least, most = float(values[worst, 0]), float(values[worst, 2])
    if not least > 1e-12 * most:
        return np.inf, np.full(len(resistance), np.inf)
    currents = K[worst].T @ axes[worst, :, 0] / (least * resistance)
    return 1.0 / least, currents**2


def find_heat(candidate: DesignCandidate) -> float:
    """[W/N²], see `find_heaviest`."""
    return find_heaviest(candidate)[0]


def find_peak(candidate: DesignCandidate) -> float:
    """[N] at full current, as far as the supply gives it."""
    return _ball(candidate, array_of(candidate).driven_current)


def find_continuous(candidate: DesignCandidate) -> float:
    """[N] with continuous currents in all coils."""
    device = array_of(candidate)
    return _ball(candidate, np.minimum(device.sustained_current_together, device.driven_current))


def find_isotropy(candidate: DesignCandidate) -> float:
    """Smallest over greatest force per ampere by direction, at the worst place; 0 with fewer than three coils."""
    K = _maps(candidate)[0]
    values = np.linalg.svd(K, compute_uv=False)
    return float((values[:, 2] / values[:, 0]).min()) if K.shape[2] >= 3 else 0.0


def find_pull(candidate: DesignCandidate) -> float:
    """[N] greatest force without current; 0 without a core."""
    return float(np.linalg.norm(_maps(candidate)[1], axis=1).max())


def _ball(candidate: DesignCandidate, limit: Array) -> float:
    device, K = array_of(candidate), _maps(candidate)[0]
    resistance, power = device.greatest_resistance, device.supply.power

    def reach(normals: Array, at: Array) -> Array:
        return greatest_force(normals @ at, limit, resistance, power)

    first, second = np.triu_indices(len(limit), 1)
    facets: Array = np.cross(K[:, :, first], K[:, :, second], axis=1).transpose(0, 2, 1)
    axes = np.linalg.eigh((K / resistance) @ K.transpose(0, 2, 1))[1].transpose(0, 2, 1)
    around = np.broadcast_to(cap_directions(np.pi / 2, _AROUND), (len(K), _AROUND, 3))
    size = np.linalg.norm(facets, axis=2, keepdims=True)
    parallel = size <= 1e-9 * size.max(axis=1, keepdims=True, initial=0.0)
    facets = np.where(parallel, around[:, :1], facets / np.where(parallel, 1.0, size))
    normals = np.concatenate([facets, axes, around], axis=1)
    found = reach(normals, K)
    place, row = np.unravel_index(np.argmin(found), found.shape)
    least, normal = float(found[place, row]), normals[place, row]
    cap = cap_directions(0.2, _AROUND) - np.array([0.0, 0.0, 1.0])
    for _ in range(_ROUNDS):
        near = normal + cap @ State.at(normal).R_SR.T
        near /= np.linalg.norm(near, axis=1, keepdims=True)
        values = reach(near, K[place])
        best = int(np.argmin(values))
        if values[best] < least:
            least, normal = float(values[best]), near[best]
        cap = 0.4 * cap
    return least


def greatest_force(per_ampere: Array, limit: Array, resistance: Array, power: float) -> Array:
    """Greatest c·i [N] for c = `per_ampere` (..., m) [N/A] with |i_j| ≤ `limit` (m,) [A] and Σ R_j i_j² ≤ `power` [W].

    The currents are min(μ |c_j|/R_j, I_j): coils reach their limits in the order of R_j I_j/|c_j|, and μ is what uses
    up the power with the first few at theirs. Exact.
    """
    c = np.abs(per_ampere)
    c = np.maximum(c, 1e-12 * c.max(axis=-1, keepdims=True) + 1e-300)
    heat = resistance * limit**2
    supplied = min(power, 2.0 * float(heat.sum()))
    turn = resistance * limit / c  # μ at which a coil is at its limit
    order = np.argsort(turn, axis=-1)

    def sort(values: Array) -> Array:
        return np.take_along_axis(np.broadcast_to(values, c.shape), order, axis=-1)

    full, rest = sort(heat), sort(c**2 / resistance)
    none = np.zeros((*c.shape[:-1], 1))
    before = np.concatenate([none, np.cumsum(full, axis=-1)], axis=-1)  # heat of the first k, at their limits
    after = np.concatenate([np.cumsum(rest[..., ::-1], axis=-1)[..., ::-1], none], axis=-1)  # of the others, for μ = 1
    needed = before[..., :-1] + sort(turn) ** 2 * after[..., :-1]
    k = (needed <= supplied).sum(axis=-1)[..., None]
    force = np.concatenate([none, np.cumsum(sort(c * limit), axis=-1)], axis=-1)
    left = np.maximum(supplied - np.take_along_axis(before, k, axis=-1), 0.0) * np.take_along_axis(after, k, axis=-1)
    found: Array = (np.take_along_axis(force, k, axis=-1) + np.sqrt(left))[..., 0]
    return found
