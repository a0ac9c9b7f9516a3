"""Force of a spherical electromagnet on a radial tool in contact, in the worst direction and position in the workspace.

Those of a coil array, by the same names, are in `array_force`. All are of the exact model: the tool's magnet at its
size. The forces {K i, |i| ≤ I} of three coils fill a parallelepiped, whose greatest ball has the radius min over k of
I_k/|row k of K⁻¹|.
"""

from __future__ import annotations

import numpy as np

from haptorb.design.candidate import DesignCandidate
from haptorb.design.objectives import array_force
from haptorb.design.objectives.registry import describe, option
from haptorb.devices.device import require
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.numerics.directions import cap_directions

__all__ = ["QUANTITIES", "electromagnet_of", "find_heaviest"]

_PLACES = 40
_ELECTROMAGNET, _ARRAY = "spherical-electromagnet", "coil-array"


def electromagnet_of(candidate: DesignCandidate) -> SphericalElectromagnet:
    """The candidate's device; InputError if it is no spherical electromagnet."""
    return require(candidate.device, SphericalElectromagnet, "this quantity")


def _maps(candidate: DesignCandidate) -> tuple[Array, Array, Array]:
    """(n, 3, 3) force per ampere [N/A], (n, 3) force without current [N], (n, 3, 3) by the published model."""

    def compute() -> tuple[Array, Array, Array]:
        device = electromagnet_of(candidate)
        places = cap_directions(device.workspace_half_angle, int(option(candidate, "places", _PLACES)))
        states = [State.at(device.contact_distance * place) for place in places]
        exact = [device.wrench_map(state, "exact") for state in states]
        return (
            np.stack([one.force for one in exact]),
            np.stack([one.passive[:3] for one in exact]),
            np.stack([device.wrench_map(state, "published").force for state in states]),
        )

    return candidate.share("electromagnet: maps", compute)


def find_heaviest(candidate: DesignCandidate) -> tuple[float, Array]:
    """Greatest heat for a force [W/N²] at the reference temperature, and the squares (m,) of the currents [A²/N²] that
    make it: in the worst direction and place."""
    resistance = electromagnet_of(candidate).coils.resistance
    per_newton = np.linalg.inv(_maps(candidate)[0])
    values, axes = np.linalg.eigh(per_newton.transpose(0, 2, 1) @ (resistance[:, None] * per_newton))
    worst = int(np.argmax(values[:, 2]))
    currents = per_newton[worst] @ axes[worst, :, 2]
    return float(values[worst, 2]), currents**2


def _heat(candidate: DesignCandidate) -> float:
    return find_heaviest(candidate)[0]


def _ball(candidate: DesignCandidate, limit: Array) -> float:
    device = electromagnet_of(candidate)
    per_newton = np.linalg.inv(_maps(candidate)[0])
    within = (limit / np.linalg.norm(per_newton, axis=2)).min()
    heat = per_newton.transpose(0, 2, 1) @ (device.greatest_resistance[:, None] * per_newton)
    supplied = np.sqrt(device.supply.power / np.linalg.eigvalsh(heat)[:, 2].max())
    return float(min(within, supplied))


def _peak(candidate: DesignCandidate) -> float:
    return _ball(candidate, electromagnet_of(candidate).driven_current)


def _continuous(candidate: DesignCandidate) -> float:
    device = electromagnet_of(candidate)
    return _ball(candidate, np.minimum(device.sustained_current_together, device.driven_current))


def _isotropy(candidate: DesignCandidate) -> float:
    values = np.linalg.svd(_maps(candidate)[0], compute_uv=False)
    return float((values[:, 2] / values[:, 0]).min())


def _pull(candidate: DesignCandidate) -> float:
    return float(np.linalg.norm(_maps(candidate)[1], axis=1).max())


def _model_error(candidate: DesignCandidate) -> float:
    exact, _, published = _maps(candidate)
    return float(np.linalg.norm(exact @ np.linalg.inv(published) - np.eye(3), 2, axis=(1, 2)).max())


_OVER = (
    "on a radial tool (over a plate an upright one) in contact, in the worst direction and position in the workspace"
)
QUANTITIES = (
    describe("heat_per_force_squared", "W/N²", "minimise",
             f"Smallest heat for a force, divided by its square, {_OVER}; coils at their reference temperature.",
             {_ELECTROMAGNET: _heat, _ARRAY: array_force.find_heat}),
    describe("peak_force", "N", "maximise", f"Force at full current, within the supply's power, {_OVER}.",
             {_ELECTROMAGNET: _peak, _ARRAY: array_force.find_peak}),
    describe("continuous_force", "N", "maximise",
             f"Continuous force in all coils, {_OVER}.",
             {_ELECTROMAGNET: _continuous, _ARRAY: array_force.find_continuous}),
    describe("force_isotropy", "", "maximise",
             "Ratio of smallest to largest force per ampere over all directions, in contact, at the worst position.",
             {_ELECTROMAGNET: _isotropy, _ARRAY: array_force.find_isotropy}),
    describe("core_pull", "N", "minimise",
             "Largest pull of the core on a radial tool in contact, without current.",
             {_ELECTROMAGNET: _pull, _ARRAY: array_force.find_pull}),
    describe("force_model_error", "", "minimise",
             "Largest relative error of the published dipole model's force on a radial tool in contact.",
             {_ELECTROMAGNET: _model_error}),
)  # fmt: skip
