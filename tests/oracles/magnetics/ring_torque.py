"""Force and torque of a point moment on a ring magnet by its charges: an independent way to the exact level.

An axially magnetised ring is two charged annuli, ±M on its faces. The charges in a dipole's field are summed over rings
(uniform in azimuth) and radii (Gauss). No code of the product is used.
"""

import numpy as np

MU0 = 4e-7 * np.pi


def dipole_field(moment, r):
    """(n, 3) flux density [T] of `moment` (3,) [A·m²] at r (n, 3) [m]."""
    d = np.linalg.norm(r, axis=1, keepdims=True)
    along = r @ moment
    return MU0 / (4 * np.pi) * (3 * r * along[:, None] / d**5 - moment / d**3)


def wrench_on_ring(moment, tool, p, R):
    """(6,) on a ring magnet (`inner_radius`, `outer_radius`, `length`, `remanence`) centred at p, along R's z axis."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    half = 0.5 * (tool.outer_radius - tool.inner_radius)
    radii = tool.inner_radius + half * (nodes + 1)
    turn = 2 * np.pi * np.arange(48) / 48
    rho, phi = np.meshgrid(radii, turn, indexing="ij")
    area = np.repeat((weights * half * radii * 2 * np.pi / 48)[:, None], 48, axis=1).ravel()
    out = np.zeros(6)
    for side in (1.0, -1.0):
        face = np.column_stack([(rho * np.cos(phi)).ravel(), (rho * np.sin(phi)).ravel()])
        local = np.column_stack([face, np.full(len(face), side * tool.length / 2)])
        arm = local @ R.T
        force = (side * tool.remanence / MU0 * area)[:, None] * dipole_field(moment, p + arm)
        out[:3] += force.sum(axis=0)
        out[3:] += np.cross(arm, force).sum(axis=0)
    return out
