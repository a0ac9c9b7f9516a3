"""Least squares over the touches of a session: frame and tip by Gauss–Newton, and what no touch determines.

Frame and tip are stepped as x ↦ exp(δ) x + τ and a ↦ a + α, with x = R (P + Q a) + t the tip in the stator frame, so

    ∂x/∂δ = −[x]ₓ,    ∂x/∂τ = 1,    ∂x/∂α = R Q.

The dome alone leaves δ free, exactly: its normal is along x, and x · (δ × x) = 0. It holds the centre; the marks hold
the turn.
"""

from __future__ import annotations

from typing import final

import numpy as np

from haptorb.errors import CalibrationError
from haptorb.numerics.arrays import Array
from haptorb.sensing.frame.touches import TouchSession

__all__ = ["UNKNOWNS", "FrameFit", "find_unobservable"]

UNKNOWNS = ("turn about x", "turn about y", "turn about z", "shift along x", "shift along y", "shift along z",
            "tip along the body's x", "tip along the body's y", "tip along the body's z")  # fmt: skip

_STEPS = 20
_SETTLED = 1e-9  #: [m]
_LEFT_OUT = 4.0  #: robust standard deviations from which a touch on the dome is left out
_LEAST = 0.3e-3  #: but none that is nearer than this [m]
_FREE = 1e-2  #: share of the greatest singular value below which a direction is not observable: noise alone makes some


@final
class FrameFit:
    """Least squares over dome and marks together: known (k, 3) [m] marks, from R (3, 3), t (3,) and tip (3,) [m]."""

    def __init__(
        self, touched: TouchSession, names: tuple[str, ...], known: Array, radius: float, R: Array, t: Array, tip: Array
    ) -> None:
        stands = [touched.marks[name] for name in names]
        self.dome = len(touched.dome)
        self.p = np.concatenate([touched.dome.p, *(one.p for one in stands)])
        self.Q = np.concatenate([touched.dome.R, *(one.R for one in stands)])
        self.known = np.repeat(known, [len(one) for one in stands], axis=0)
        self.radius, self.R, self.t, self.tip = radius, R, t, tip
        self.on = np.ones(self.dome, dtype=bool)

    @property
    def x(self) -> Array:
        """(n, 3) the tip in the stator frame [m], dome first."""
        placed: Array = (self.p + self.Q @ self.tip) @ self.R.T + self.t
        return placed

    def equations(self) -> tuple[Array, Array]:
        """(residuals (m,) [m], Jacobian (m, 9)); turns times the dome's radius, so that all unknowns are lengths."""
        x = self.x
        J = np.zeros((len(x), 3, 9))
        J[:, 0, 1], J[:, 0, 2], J[:, 1, 2] = x[:, 2], -x[:, 1], x[:, 0]
        J[:, 1, 0], J[:, 2, 0], J[:, 2, 1] = -x[:, 2], x[:, 1], -x[:, 0]
        J[:, :, :3] /= self.radius
        J[:, :, 3:6] = np.eye(3)
        J[:, :, 6:] = self.R @ self.Q
        distance = np.linalg.norm(x[: self.dome], axis=1)
        normal = x[: self.dome] / distance[:, None]
        dome = np.einsum("ij,ijk->ik", normal, J[: self.dome])
        left = np.concatenate([(distance - self.radius)[self.on], (x[self.dome :] - self.known).ravel()])
        return left, np.concatenate([dome[self.on], J[self.dome :].reshape(-1, 9)])

    def settle(self) -> None:
        """Gauss–Newton to the end, then once more without the touches at which the tip was off the dome.

        Raises CalibrationError if it does not settle.
        """
        for _ in range(3):
            for _ in range(_STEPS):
                left, J = self.equations()
                step, *_ = np.linalg.lstsq(J, -left, rcond=None)
                turn = _rotation(np.asarray(step[:3] / self.radius))
                self.R, self.t, self.tip = turn @ self.R, turn @ self.t + step[3:6], self.tip + step[6:]
                if np.abs(step).max() < _SETTLED:
                    break
            else:
                raise CalibrationError("the fit of the frame does not converge: touch the dome and all marks again")
            off = np.linalg.norm(self.x[: self.dome], axis=1) - self.radius
            scale = 1.4826 * float(np.median(np.abs(off - np.median(off))))
            before, self.on = self.on, np.abs(off) <= max(_LEFT_OUT * scale, _LEAST)
            if (self.on == before).all():
                return


def find_unobservable(J: Array, names: tuple[str, ...] = UNKNOWNS) -> tuple[float, tuple[str, ...]]:
    """(condition, what is not observable): directions of the unknowns that no equation of J (n, 9) sees, in words.

    >>> find_unobservable(np.eye(9)[:8])[1]
    ("tip along the body's z",)
    """
    _, s, Vt = np.linalg.svd(np.vstack([J, np.zeros((len(names), len(names)))]), full_matrices=False)
    free = Vt[s <= _FREE * s[0]]
    share = (free**2).sum(axis=0)
    unseen = tuple(name for name, part in zip(names, share, strict=True) if part > 0.3)
    return float(s[0] / s[-1]) if s[-1] > 0 else float("inf"), unseen


def _rotation(w: Array) -> Array:
    """(3, 3) the rotation by the vector w [rad] (Rodrigues)."""
    angle = max(float(np.linalg.norm(w)), 1e-9)
    K = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    R: Array = np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * K @ K
    return R
