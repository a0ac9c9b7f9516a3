"""Force of a spherical electromagnet on a radial tool in contact, in the worst direction and position in the workspace.

Those of a coil array, with the same names, are in `array_force`. All use the tool's magnet at its true size and, if
the windings determine the moments (`windings.fill`), windings and core at theirs: in contact, their force differs by up
to a third from that of a point dipole with the moments of the device file. The forces {K i, |i| ≤ I} of three coils
fill a parallelepiped, whose greatest ball has the radius min over k of I_k/|row k of K⁻¹|.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from haptorb.design.candidate import DesignCandidate
from haptorb.design.objectives import array_force
from haptorb.design.objectives.registry import describe, option
from haptorb.devices.device import require
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.state import State
from haptorb.errors import InputError
from haptorb.numerics.arrays import Array
from haptorb.numerics.directions import cap_directions
from haptorb.physics.fast_fields.centred_coil import CentredCoil
from haptorb.physics.fast_fields.sphere_answer import add_answers, answer_to_charges, harmonic_sums, weigh_charges
from haptorb.physics.sources.charged_ring import ChargedRing, dipole_on_charges

__all__ = ["QUANTITIES", "electromagnet_of", "find_heaviest", "find_winding_force"]

_PLACES = 40
_ELECTROMAGNET, _ARRAY = "spherical-electromagnet", "coil-array"


def electromagnet_of(candidate: DesignCandidate) -> SphericalElectromagnet:
    """The candidate's device; InputError if it is no spherical electromagnet."""
    return require(candidate.device, SphericalElectromagnet, "this quantity")


def _list_states(candidate: DesignCandidate) -> list[State]:
    device = electromagnet_of(candidate)
    places = cap_directions(device.workspace_half_angle, int(option(candidate, "places", _PLACES)))
    return [State.at(device.contact_distance * place) for place in places]


def _maps(candidate: DesignCandidate) -> tuple[Array, Array, Array]:
    """(n, 3, 3) force per ampere [N/A], (1, 3) force without current [N], (n, 3, 3) by the published model."""

    def compute() -> tuple[Array, Array, Array]:
        device, states = electromagnet_of(candidate), _list_states(candidate)
        wound = device.moments_from == "windings"
        return (
            find_winding_force(device, states) if wound else _find_dipole_force(device, states),
            np.stack([_find_core_force(device, state) for state in states[:1]]),  # the same at every place
            np.stack([device.wrench_map(state, "published").force for state in states]),
        )

    return candidate.share("electromagnet: maps", compute)


def _list_charges(device: SphericalElectromagnet, azimuth: int = 8) -> Array:
    """(4, n) of the tool's magnet, in the tool's frame [m, A·m]."""
    tool = device.tool
    return ChargedRing(
        tool.outer_radius, tool.inner_radius, tool.length, tool.remanence, radial=2, azimuth=azimuth
    ).rows


def _find_dipole_force(device: SphericalElectromagnet, states: Sequence[State]) -> Array:
    """(n, 3, 3) force per ampere [N/A] of the device's own exact model, without the table of the core's pull, which
    takes longer than the rest of a candidate."""
    charges, per_moment = _list_charges(device), np.empty((len(states), 6, 3))
    for state, out in zip(states, per_moment, strict=True):
        dipole_on_charges(charges, np.ascontiguousarray(state.R_SR), np.ascontiguousarray(state.p), out)
    force: Array = per_moment[:, :3] @ device.moment_per_current
    return force


def _find_core_force(device: SphericalElectromagnet, state: State) -> Array:
    """(3,) force [N] of the core on the tool without current."""
    core, p = device.core, np.ascontiguousarray(state.p)
    charges = _list_charges(device, azimuth=16)
    placed = np.vstack([state.R_SR @ charges[:3] + p[:, None], charges[3:]])
    nearest = float(np.linalg.norm(placed[:3], axis=0).min())
    order = core.order(nearest, nearest, precision=1e-7)
    sums = np.empty(((order + 2) * (order + 3) // 2, 2))
    harmonic_sums(np.ascontiguousarray(placed), core.radius, order, sums)
    shares = weigh_charges(core, order)
    answers, wrench = np.empty((1, len(shares), 2)), np.zeros((6, 1))
    answer_to_charges(sums, shares, answers)
    add_answers(sums, answers, core.radius, order, p, wrench)
    force: Array = wrench[:3, 0]
    return force


def find_winding_force(device: SphericalElectromagnet, states: Sequence[State]) -> Array:
    """(n, 3, 3) force per ampere [N/A] on the tool's magnet, of the device's windings and core at their true size.

    InputError for a device without windings.
    """
    windings, tool = device.windings, device.tool
    if windings is None:
        raise InputError(f"device '{device.name}' has no [windings]: their sizes are needed for this quantity")
    nearest = min(state.distance for state in states) - tool.length / 2
    charges = _list_charges(device)
    at = np.stack([(state.R_SR @ charges[:3]).T + state.p for state in states])
    out = np.empty((len(states), 3, device.channels))
    for number, coil in enumerate(windings.coils):
        turn = np.roll(np.eye(3), 2 - number, axis=1)  # columns: the coil's axes; its z is the stator's x, y or z
        field = CentredCoil(coil, device.core, nearest).field(at @ turn) @ turn.T
        out[:, :, number] = (charges[3][:, None] * field).sum(axis=1)
    return out


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


def _radial(candidate: DesignCandidate) -> float:
    device = electromagnet_of(candidate)
    radii = np.stack([state.R_SR[:, 2] for state in _list_states(candidate)])
    amperes = np.einsum("nij,nj->ni", np.linalg.inv(_maps(candidate)[0]), radii)  # of one newton along the radius
    limit = np.minimum(device.sustained_current_together, device.driven_current)
    supplied = np.sqrt(device.supply.power / (device.greatest_resistance * amperes**2).sum(axis=1))
    return float(np.minimum((limit / np.abs(amperes)).min(axis=1), supplied).min())


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
    describe("continuous_radial_force", "N", "maximise",
             "Force along the radius alone, in contact, continuous in all coils, at the worst position in the "
             "workspace.", {_ELECTROMAGNET: _radial}),
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
