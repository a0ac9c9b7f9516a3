"""Bai 2012, eqs. (7) to (9): positions of the poles, their field, and the resulting torque (errata E1, E5)."""

from __future__ import annotations

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.api import motor, torque_characteristic
from haptorb.devices.loader import load
from haptorb.devices.motor import SphericalMotor
from haptorb.magnetics.dipole import MU0
from haptorb.magnetics.multipole import MAGNET_RADIUS, load_published
from haptorb.rotations import rotation_from_euler
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Report

__all__ = ["items"]

_AT = Citation("bai2012", "dmp", "eqs. (7)–(9)")
EM17 = 16


def items(report: Report) -> tuple[tuple[Item, ...], None]:
    """Loops, field, and eq. (9) against virtual work, as printed, and against exact bodies over the workspace."""
    device = motor("pmsm")
    R = rotation_from_euler(*np.radians((10.0, 5.0, 5.0)))
    by_model = torque_characteristic(device, R, "published")[:, EM17]
    work = _virtual_work(device, R)
    printed = _equation_9_torque(device, R)
    exact = torque_characteristic(device, R, "table")[:, EM17]  # the exact model to 1e-7
    report(0.3)
    scale, shape = _scale_and_shape(device)
    report(0.7)
    other, _ = _scale_and_shape(motor(load("pmsm-thick-coils", override=True)))
    pm, em = load_published("bai2012-pm").model, load_published("bai2012-em").model
    found = [
        *(
            _AT.claim(f"7-{name}", f"outermost loop of the {name.upper()}, a₀ⱼ read as j a: a k/(k + 1)", radius,
                     1e3 * _outermost(model),
                     "mm", 5e-4, erratum="E28", where="eq. (7)")
            for name, model, radius in (("pm", pm, 15.875 * 4 / 5), ("em", em, 15.88 * 6 / 7))
        ),
        _AT.claim("8-axis", "field 10 mm above the middle of one PM by (8), summed independently, against the "
                            "library's",
                 1e3 * _axis_field(10e-3), 1e3 * pm.field((0, 0, 10e-3))[2], "mT", 1e-9, erratum="E1", where="eq. (8)"),
        *(
            _AT.claim(f"9-printed-{axis.lower()}", f"K₁₇ about {axis} at q = (10°, 5°, 5°): as printed, and corrected",
                     printed[k], by_model[k], "N·m/A", 1e-5, "step of the numerical derivative", erratum="E5",
                     corrected=work[k], where="eq. (9)")
            for k, axis in ((1, "Y"), (2, "Z"))
        ),
        _AT.claim("9-x", "K₁₇ about X: a round coil on the X axis has no torque about it", 0.0, by_model[0], "N·m/A",
                 1e-4, "sixteen poles on a loop are not quite a circle", where="eq. (9)"),
        *(
            _AT.note(f"9-exact-{axis.lower()}", f"K₁₇ about {axis} at q = (10°, 5°, 5°) by exact bodies", exact[k],
                     "N·m/A", where="eq. (9)")
            for k, axis in ((1, "Y"), (2, "Z"))
        ),
        _AT.claim("9-scale", "published model over exact bodies, all coils, workspace: best factor", 1.0, scale, "1",
                 0.06, "the accuracy of a model with 41 and 97 pole pairs", erratum="E1", where="eq. (9)"),
        _AT.claim("9-shape", "remainder after that factor, rms over rms", 0.0, shape, "1", 0.03,
                 "the same", erratum="E1", where="eq. (9)"),
        _AT.note("9-aspect", "the best factor with the coils' l read as l/2a = 0.3", other, "1",
                 "27 to 30 % off: this reading is rejected", where="eq. (9)"),
    ]  # fmt: skip
    report(1.0)
    return tuple(found), None


def _outermost(model: object) -> float:
    poles: Array = model.poles  # type: ignore[attr-defined]
    return float(np.hypot(poles[:, 0], poles[:, 1]).max())


def _axis_field(z: float) -> float:
    """B_z [T] on the axis of one PM by eq. (8), the axis pair once; l̄ = 0.2 · 0.2 inch."""
    half, total = 0.5 * 0.2 * 5.08e-3, 0.0
    for j, (strength, count) in enumerate(zip((33.5, 24.5, 57.6, 52.0, 276.1), (1, 10, 10, 10, 10), strict=True)):
        radius = MAGNET_RADIUS * j / 5  # Eq. (7)
        for side in (1.0, -1.0):
            up = z - side * half
            total += side * strength * count * up / (radius**2 + up**2) ** 1.5
    return MU0 / (4 * np.pi) * total


def _poles(device: SphericalMotor, R: Array) -> tuple[Array, Array, Array, Array]:
    """Poles of the whole rotor and of EM 17 (·, 3) [m], and their signed strengths: sources first, then sinks."""
    pm, em = device.magnet_model, device.coil_model
    assert pm is not None
    assert em is not None
    frames = R @ device.magnets.frames
    centres = device.magnets.positions @ R.T
    each = np.swapaxes(np.einsum("iab,pb->ipa", frames, pm.poles) + centres[:, None], 0, 1)
    strengths = np.outer(pm.strengths, device.polarity)
    coil = em.poles @ device.electromagnets.frames[EM17].T + device.electromagnets.positions[EM17]
    return each.reshape(-1, 3), strengths.ravel(), coil, em.strengths


def _virtual_work(device: SphericalMotor, R: Array) -> Array:
    """(3,) [N·m/A]: minus the derivative, by a turn of the rotor, of the energy of all pole pairs."""
    at, q, coil, s = _poles(device, R)

    def energy(way: Array) -> float:
        turned = at @ _small_rotation(way).T
        apart = np.linalg.norm(turned[:, None] - coil, axis=-1)
        return float(MU0 / (4 * np.pi) * q @ (1 / apart) @ s)

    h = 1e-5
    return np.array([(energy(-h * e) - energy(h * e)) / (2 * h) for e in np.eye(3)])


def _small_rotation(way: Array) -> Array:
    from scipy.spatial.transform import Rotation

    turn: Array = Rotation.from_rotvec(way).as_matrix()
    return turn


def _equation_9_torque(device: SphericalMotor, R: Array) -> Array:
    """(3,) [N·m/A] by eq. (9) word by word: force × arm, and a plus in the second bracket."""
    at, q, coil, s = _poles(device, R)
    n, v = len(q) // 2, len(s) // 2
    apart = at[:, None] - coil
    apart /= np.linalg.norm(apart, axis=-1, keepdims=True) ** 3
    plus, minus = (np.einsum("s,rsi->ri", s[:v], apart[:, half]) for half in (slice(None, v), slice(v, None)))
    first = np.cross(plus[:n] - minus[:n], at[:n])
    second = np.cross(plus[n:] + minus[n:], at[n:])
    torque: Array = MU0 / (4 * np.pi) * (q[:n, None] * (first - second)).sum(axis=0)
    return torque


def _scale_and_shape(device: SphericalMotor, count: int = 12) -> tuple[float, float]:
    """Best factor between published model and exact bodies, and what it leaves, over `count` orientations."""
    rng = np.random.default_rng(12)
    psi, lam = rng.uniform(-device.workspace_tilt, device.workspace_tilt, (2, count))
    R = rotation_from_euler(psi, lam, rng.uniform(0, 2 * np.pi, count))
    model, true = (torque_characteristic(device, R, model) for model in ("published", "table"))
    scale = float((model * true).sum() / (true * true).sum())
    return scale, float(np.linalg.norm(model - scale * true) / np.linalg.norm(scale * true))
