"""Zárate 2020, eqs. (1), (2) and §II.A: forces of two dipoles, and their decay with distance (E12, E16, E33)."""

from __future__ import annotations

from math import cos, degrees, pi, radians, sin
from pathlib import Path

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.api import electromagnet
from haptorb.devices.base import State
from haptorb.devices.electromagnet import FORCE_JND, SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.magnetics import dipole
from haptorb.magnetics.dipole import MU0, Dipole
from haptorb.magnetics.interaction import wrench
from haptorb.magnetics.magnets import RingMagnet
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.entry import read_entry
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Drawing, Report
from haptorb_papers.reproduce.zarate2020.inverse_error import compute_second_wrench

__all__ = ["items"]

_AT = Citation("zarate2020", "model", "§II.A")
_ME = 2.5  #: [A·m²] of the electromagnet, for the formulas


def items(report: Report) -> tuple[tuple[Item, ...], Drawing]:
    """(1) and (2) against the gradient of the energy, the fall with distance, and the shell."""
    device = electromagnet(load("omni"))
    contact, m_p = device.contact_distance, device.tool.moment
    scale = 3 * MU0 * _ME * m_p / (4 * pi * contact**4)
    found: list[Item] = []
    for alpha in (45.0, 135.0):
        a = radians(alpha)
        force = _energy_gradient(a, contact, m_p)
        out, away = np.array([sin(a), 0, cos(a)]), np.array([cos(a), 0, -sin(a)])
        found.append(
            _AT.claim(f"1-{alpha:.0f}", f"(1): F_r at α = {alpha:.0f}°, m_e = 2.5 A·m²", -2e3 * scale * cos(a),
                     1e3 * float(force @ out), "mN", 1e-3, "finite differences of the energy", where="eq. (1)")
        )  # fmt: skip
        found.append(
            _AT.claim(f"2-{alpha:.0f}", f"(2): F_t at α = {alpha:.0f}°, e_t away from the dipole's axis",
                     -1e3 * scale * sin(a), 1e3 * float(force @ away), "mN", 1e-3,
                     "finite differences of the energy", erratum="E12", where="eq. (2)")
        )  # fmt: skip
    found.append(
        _AT.claim("1-leaning", "force on a tool 25° from the dipole's axis that leans 20° outwards, over that on a "
                  "radial tool at 45°: α = 45° for both ('depend only on α')", 1.0, _lean(device), "1", 1e-5,
                  "finite differences of the energy", erratum="E33",
                  corrected=_lean_by_energy(contact), where="eqs. (1), (2)")
    )  # fmt: skip
    report(0.3)
    pull = {d: _axial(device, 1e-3 * d) for d in (50, 60, 70)}
    even = _moment_ratio(device)
    found += [
        _AT.item("dmin", "d_min: 30 mm of case and 20 mm to the magnet", 50.0,
                 read_entry(device, "contact_distance", 1e3), "mm"),
        _AT.item("diameter", "diameter of the device", 60.0, read_entry(device, "dome_radius", 2e3), "mm", where="§I"),
        _AT.item("shell", "thickness of the shell", 2.0, read_entry(device, "shell_thickness", 1e2), "cm"),
        _AT.item("workspace", "half angle of the partial shell, ±60°", 60.0,
                 read_entry(device, "workspace_half_angle", degrees(1.0)), "°", where="§I.A"),
        _AT.claim("even", "greatest over least force on the shell at contact, |m_e| held ('symmetric, constant')", 1.0,
                 even, "1", 1e-9, "by symmetry", where="§I.A"),
        _AT.item("half", "force 1 cm further out over the one at contact: 'approximately F/2'", 0.5,
                 pull[60][0] / pull[50][0], "1", 0.03, "'approximately'; 0.482"),
        _AT.item("quarter", "force 2 cm further out: 'F/4'", 0.25, pull[70][0] / pull[50][0], "1", 0.03,
                 "'approximately'; 0.260"),
        _AT.note("half-exact", "the same 1 cm out with the magnet at its size", pull[60][1] / pull[50][1], "1",
                 "the force of a long magnet decreases faster (E16)"),
        _AT.note("quarter-exact", "and 2 cm out", pull[70][1] / pull[50][1], "1", "the same"),
        _AT.item("fourth", "exponent of force by distance, 1/d⁴", -4.0, _exponent(device, 2), "1", 1e-3,
                 "difference over 1 %"),
        _AT.item("third", "exponent of torque by distance, 1/d³", -3.0, _exponent(device, 4), "1", 1e-3,
                 "difference over 1 %"),
        _AT.item("flip", "rotation of the dipole that changes the largest pull into the largest "
                         "push", 180.0, _angle(), "°",
                 1.0, "grid of 1°"),
        *(
            _AT.claim(f"size-{d}", f"force of a dipole on the ring over that on a point at {d} mm", 1.0,
                      pull[d][1] / pull[d][0], "1", 5e-4,
                     "a dipole's field on the bound currents of the ring's walls", erratum="E16",
                     corrected=_find_excess(device, 1e-3 * d))
            for d in (50, 60, 70)
        ),
        _AT.claim("far", "(1): pull of the ring at its size, bound currents in a dipole's field, over that of two "
                 "dipoles at 50 cm", 1.0, _find_excess(device, 0.5), "1", 3e-3, "the length of the ring contributes "
                                                                                "0.15 %",
                 where="eq. (1)"),
        *(
            _AT.claim(f"coils-{d}", f"force of the z coil over that of two dipoles at {d} mm", 1.0,
                      _coil_ratio(device, d), "1", 5e-4,
                     "loops, and a core of charges, on the ring's bound currents", erratum="E35",
                     corrected=_second_ratio(device, d))
            for d in (50, 60, 70)
        ),
        _AT.note("size-jnd", "the same at contact in just-noticeable differences of force",
                 (pull[50][1] / pull[50][0] - 1) / FORCE_JND, "1"),
    ]  # fmt: skip
    report(1.0)
    return tuple(found), lambda path: _draw_figure(device, path)


def _place(angle: float, lean: float, d: float) -> tuple[Array, Array]:
    """Position of a tool `angle` [rad] from the axis, and direction of its moment, `lean` [rad] further from it."""
    return d * np.array([sin(angle), 0.0, cos(angle)]), np.array([sin(angle + lean), 0.0, cos(angle + lean)])


def _lean(device: SphericalElectromagnet) -> float:
    sizes = []
    for angle, lean in ((radians(25.0), radians(20.0)), (radians(45.0), 0.0)):
        place, points = _place(angle, lean, device.contact_distance)
        sizes.append(np.linalg.norm(dipole.force((0, 0, _ME), device.tool.moment * points, place)))
    return float(sizes[0] / sizes[1])


def _lean_by_energy(d: float) -> float:
    """The same by −∇(m · B): the field of the dipole in the centre differentiated by finite differences."""
    sizes, h = [], 1e-5
    for angle, lean in ((radians(25.0), radians(20.0)), (radians(45.0), 0.0)):
        place, points = _place(angle, lean, d)

        def energy(p: Array, points: Array = points) -> float:
            r = float(np.linalg.norm(p))
            return float(points[2] / r**3 - 3 * (points @ p) * p[2] / r**5)  # of two unit dipoles

        slope = [(energy(place + h * e) - energy(place - h * e)) / (2 * h) for e in np.eye(3)]
        sizes.append(float(np.linalg.norm(slope)))
    return sizes[0] / sizes[1]


def _energy_gradient(alpha: float, d: float, m_p: float) -> Array:
    """(3,) force [N] on a radial tool: minus the gradient of −m_p·B of the other dipole."""
    out = np.array([sin(alpha), 0.0, cos(alpha)])

    def energy(p: Array) -> float:
        return -m_p * float(out @ dipole.field((0, 0, _ME), p))

    h = 1e-6
    return np.array([-(energy(d * out + h * e) - energy(d * out - h * e)) / (2 * h) for e in np.eye(3)])


def _axial(device: SphericalElectromagnet, d: float) -> tuple[float, float]:
    """Force per ampere of a dipole along z on an upright tool above the summit: on a point, and on the ring [N/A]."""
    state = State.at((0, 0, d))
    point, ring = (float(device.wrench_map(state, model).matrix[2, 2]) for model in ("published", "point-coils"))
    return point, ring


def _coil_ratio(device: SphericalElectromagnet, d: int) -> float:
    """Force of the z coil and its core on the ring over that of the published model, `d` [mm] above the centre."""
    state = State.at((0, 0, 1e-3 * d))
    real, dipoles = (float(device.wrench_map(state, model).matrix[2, 2]) for model in ("exact", "published"))
    return real / dipoles


def _second_ratio(device: SphericalElectromagnet, d: int) -> float:
    """The same by `compute_second_wrench`."""
    state = State.at((0, 0, 1e-3 * d))
    per_ampere = compute_second_wrench(device, state).per_ampere[2, 2]
    return float(per_ampere / device.wrench_map(state, "published").matrix[2, 2])


def _find_excess(device: SphericalElectromagnet, d: float) -> float:
    """Force on the ring at `d` [m] above a dipole over that on a point with its moment: I dl × B, no charges."""
    tool = device.tool
    ring = RingMagnet(tool.outer_radius, tool.inner_radius, tool.length, tool.remanence)
    whole = wrench(Dipole((0, 0, 1.0)), ring, (0, 0, d), np.eye(3)).value[2]
    return float(whole / dipole.force((0, 0, 1.0), ring.moment, (0, 0, d))[2])


def _moment_ratio(device: SphericalElectromagnet) -> float:
    """|m_e| that a radial newton takes, greatest over least, on a ring at every 15° of the workspace."""
    need = []
    for theta in np.radians(np.arange(0, 61, 15)):
        for phi in np.arange(0, 2 * pi, pi / 4):
            u = np.array([sin(theta) * cos(phi), sin(theta) * sin(phi), cos(theta)])
            matrix = device.wrench_map(State.at(device.contact_distance * u), "published").force
            need.append(np.linalg.norm(device.moment_per_current @ np.linalg.solve(matrix, u)))
    return float(max(need) / min(need))


def _exponent(device: SphericalElectromagnet, row: int) -> float:
    """d log |row of the wrench map| / d log d, upright tool above the summit."""
    places = [State.at((0, 0, 0.06 * f)) for f in (0.995, 1.005)]
    sizes = [float(np.linalg.norm(device.wrench_map(at, "published").matrix[row])) for at in places]
    return float(np.log(sizes[1] / sizes[0]) / np.log(1.005 / 0.995))


def _angle() -> float:
    angles = np.radians(np.arange(0, 360.5))
    radial = [dipole.force((sin(a), 0, cos(a)), (0, 0, 1.0), (0, 0, 0.05))[2] for a in angles]
    return float(degrees(angles[int(np.argmax(radial))] - angles[int(np.argmin(radial))]))


def _draw_figure(device: SphericalElectromagnet, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4), layout="constrained")
    FigureCanvasAgg(figure)
    panel = figure.subplots()
    d = np.linspace(device.contact_distance, device.contact_distance + 0.03, 60)
    both = 1e3 * np.abs([_axial(device, float(one)) for one in d])
    panel.plot(1e3 * d, both[:, 0], "C1--", label="two dipoles, eq. (1)")
    panel.plot(1e3 * d, both[:, 1], "C0", label="the magnet at its size")
    panel.plot([50, 60, 70], both[0, 0] * np.array([1, 0.5, 0.25]), "kx", label="'F, F/2, F/4'")
    panel.axvspan(50, 70, color="k", alpha=0.06)
    panel.set(xlabel="magnet from the centre [mm]", ylabel="force per ampere of the z coil [mN/A]", ylim=(0, None))
    panel.legend(frameon=False)
    panel.grid(alpha=0.3)
    figure.savefig(path, dpi=120)
    return path
