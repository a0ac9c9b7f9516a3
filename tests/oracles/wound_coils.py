"""The wrench of coils around a soft core on a ring magnet, without anything of the product's: fields by loops and by
charges in the core (`second_coils`), the magnet by charges on its faces."""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import State
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb_papers.reproduce.zarate2020.second_coils import compute_coil_fields as coil_fields

__all__ = ["coil_fields", "wrench_map"]

MU0 = 4e-7 * np.pi


def wrench_map(device: SphericalElectromagnet, state: State) -> Array:
    """(6, 3) [N/A, N·m/A] on the tool's ring at `state`, torque about its centre."""
    tool = device.tool
    node, weight = np.polynomial.legendre.leggauss(6)
    inner, outer = tool.inner_radius**2, tool.outer_radius**2
    rho = np.sqrt(inner + (outer - inner) * (node + 1) / 2)
    turn = 2 * np.pi * np.arange(18) / 18
    face = np.pi * (outer - inner) * tool.remanence / MU0
    x, y = np.outer(rho, np.cos(turn)).ravel(), np.outer(rho, np.sin(turn)).ravel()
    q = np.repeat(weight / 2, len(turn)) * face / len(turn)
    up = np.column_stack([x, y, np.full(len(x), tool.length / 2)])
    arms = np.vstack([up, up * [1, 1, -1]]) @ state.R_SR.T
    q = np.concatenate([q, -q])
    forces = q[:, None, None] * coil_fields(device, state.p + arms)
    torques = np.cross(arms[:, :, None], forces, axis=1)
    return np.vstack([forces.sum(axis=0), torques.sum(axis=0)])
