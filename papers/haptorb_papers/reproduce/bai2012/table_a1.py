"""Bai 2012, appendix A: positions of magnets, coils and sensors; parts must not overlap (errata E2, E3)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.api import motor
from haptorb.devices.loader import load
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import DeviceError
from haptorb_papers.reproduce.citation import Citation
from haptorb_papers.reproduce.entry import Entry, read_entry
from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.registry import Drawing, Report

__all__ = ["items"]

_AT = Citation("bai2012", "ta1", "Table A.1")
#: id, parts, first and last j, ϑ, first φ, step, first φ as corrected, erratum
_COLUMNS = (
    ("sensor-1", "sensors", 1, 16, -26, 0, 22.5, None, ""), ("sensor-17", "sensors", 17, 32, 26, 0, 22.5, None, ""),
    ("sensor-33", "sensors", 33, 48, 0, 0, 22.5, None, ""), ("em-1", "EMs", 1, 8, -26, 0, 45, 22.5, "E3"),
    ("em-9", "EMs", 9, 16, 26, 22.5, 45, None, ""), ("em-17", "EMs", 17, 24, 0, 22.5, 45, 0.0, "E3"),
    ("pm-1", "PMs", 1, 12, -15, 0, 30, None, ""), ("pm-13", "PMs", 13, 24, 15, 0, 30, None, ""),
)  # fmt: skip


def items(report: Report) -> tuple[tuple[Item, ...], Drawing]:
    """Every column, the three radii, and whether the parts fit."""
    device = motor("pmsm")
    layouts = {"sensors": device.sensor_layout, "EMs": device.electromagnets, "PMs": device.magnets}
    found: list[Item] = []
    for name, parts, first, last, latitude, start, step, corrected, erratum in _COLUMNS:
        lat, lon = _angles(layouts[parts].directions[first - 1 : last])
        found += [
            _AT.item(f"{name}-theta", f"ϑ of {parts} {first}–{last}, a latitude", latitude,
                     Entry(lat.mean(), f"pmsm: latitude of {parts} {first}–{last}"), "°", 1e-9,
                     erratum="E2" if latitude else ""),
            _AT.item(f"{name}-phi", f"φ of {parts[:-1]} {first}", start,
                     Entry(lon[0], f"pmsm: first longitude of {parts} {first}–{last}"), "°", 1e-9, erratum=erratum,
                     corrected=corrected),
            _AT.item(f"{name}-step", f"step of φ over {parts} {first}–{last}", step,
                     Entry(_step(lon), f"pmsm: step of {parts} {first}–{last}"), "°", 1e-9),
        ]  # fmt: skip
    coil, magnet = device.electromagnet, device.magnet
    u, v = device.electromagnets, device.magnets
    on_axis = np.degrees(np.arccos(np.clip(device.sensor_layout.directions @ u.directions.T, -1, 1))).min(axis=0)
    spans = [2 * np.degrees(np.arctan(r / d)) for r, d in
             ((magnet.radius, v.distance), (coil.outer_radius, u.distance))]  # fmt: skip
    printed = motor(load("pmsm-printed-table", override=True))
    found += [
        _AT.item("r-pm", "R_PM", 67.9, read_entry(device, "magnets.distance", 1e3), "mm"),
        _AT.item("r-em", "R_EM", 56.8, read_entry(device, "electromagnets.distance", 1e3), "mm"),
        _AT.item("r-sensor", "R_Sensor", 62.4, read_entry(device, "sensor_layout.distance", 1e3), "mm"),
        _AT.claim("em-17-x", "angle between EM 17 and the X axis, 'located on the X axis', coils placed by E3", 0.0,
                 np.degrees(np.arccos(u.directions[16, 0])), "°", 1e-5, "a direction", erratum="E3", where="§2.3"),
        _AT.claim("em-17-printed", "the same with the printed longitudes", 0.0,
                 np.degrees(np.arccos(printed.electromagnets.directions[16, 0])), "°", 1e-5, "45°(17 − 17) + 22.5°",
                 erratum="E3", corrected=22.5),
        _AT.compare("sensor-on-em", "greatest angle between an EM's axis and the nearest sensor, placed by E3", 0.0,
                 on_axis.max(), "°", 1e-5, "columns of sensors and EMs share their angles", erratum="E3"),
        _AT.compare("pm-apart", "room between the nearest PMs, read as latitudes: 1 if they do not overlap", 1.0,
                 float(_nearest(v.directions) > spans[0]), "1", 0.0, "28.9° against the 26.3° that one spans",
                 erratum="E2"),
        _AT.claim("pm-cone", "the same of one ring with ϑ read as a colatitude, as (A.1) is printed", 1.0,
                 float(_nearest(_colatitude(v.directions[:12])) > spans[0]), "1", 0.0, "7.7° against 26.3°",
                 erratum="E2", corrected=0.0, where="eq. (A.1)"),
        _AT.note("pm-nearest", "nearest PMs apart", _nearest(v.directions), "°"),
        _AT.note("pm-cone-nearest", "nearest PMs of one ring apart, ϑ read as a colatitude",
                 _nearest(_colatitude(v.directions[:12])), "°", "each spans 26.3°: the parts intersect (E2)"),
        _AT.compare("em-apart", "room between the nearest EMs, placed by E3: 1 if they do not overlap", 1.0,
                 float(_nearest(u.directions) > spans[1]), "1", 0.0, "33.9° against the 31.2° that one spans",
                 erratum="E3"),
        _AT.claim("em-overlap", "the same with the printed longitudes", 1.0,
                 float(_nearest(printed.electromagnets.directions) > spans[1]), "1", 0.0, "26° against 31.2°",
                 erratum="E3", corrected=0.0),
        _AT.note("em-nearest", "nearest EMs apart", _nearest(u.directions), "°"),
        _AT.note("em-printed", "the same as printed", _nearest(printed.electromagnets.directions), "°",
                 "each spans 31.2°: coils overlap (E3)"),
        _AT.compare("printed-refused", "1 if the loader rejects the table as printed", 1.0, float(_rejects()), "1",
                 0.0, "the validation must find the errors of the table", erratum="E3"),
        _AT.compare("gap", "1 if sensors lie between the coils' outer and the magnets' inner faces", 1.0,
                 float(_is_in_gap(device)), "1", 0.0, "60.61 mm < 62.4 mm < 65.36 mm with lengths in inches",
                 erratum="E1"),
        _AT.claim("alternating", "share of nearest neighbours among the PMs with opposite polarity", 1.0,
                 Entry(_opposite_share(device), "pmsm: polarity of the magnets"), "1", 0.0,
                 "'adjacent PMs have alternating magnetization'", erratum="E4", where="App. A"),
    ]  # fmt: skip
    report(1.0)
    return tuple(found), lambda path: _draw_figure(device, printed, path)


def _angles(u: Array) -> tuple[Array, Array]:
    return np.degrees(np.arcsin(u[:, 2])), np.degrees(np.arctan2(u[:, 1], u[:, 0])) + 0.0


def _step(longitude: Array) -> float:
    steps = np.diff(longitude) % 360
    return float(steps.mean()) if np.ptp(steps) < 1e-9 else float("nan")


def _angles_between(u: Array) -> Array:
    angles: Array = np.degrees(np.arccos(np.clip(u @ u.T, -1, 1))) + 360 * np.eye(len(u))
    return angles


def _nearest(u: Array) -> float:
    return float(_angles_between(u).min())


def _colatitude(u: Array) -> Array:
    """(A.1) to the letter, ϑ and φ as printed."""
    lat, lon = (np.radians(angle) for angle in _angles(u))
    return np.column_stack([np.cos(lon) * np.sin(lat), np.sin(lon) * np.sin(lat), np.cos(lat)])


def _rejects() -> bool:
    try:
        load("pmsm-printed-table")
    except DeviceError:
        return True
    return False


def _is_in_gap(device: SphericalMotor) -> bool:
    below = device.electromagnets.distance + 0.5 * device.electromagnet.length
    above = device.magnets.distance - 0.5 * device.magnet.length
    return below < device.sensor_layout.distance < above


def _opposite_share(device: SphericalMotor) -> float:
    apart = _angles_between(device.magnets.directions)
    i, j = np.nonzero(apart < 30.5)  # along a ring 28.9°, across the rings 30°
    return float(np.mean(device.polarity[i] * device.polarity[j] < 0))


def _draw_figure(device: SphericalMotor, printed: SphericalMotor, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    top, low = figure.subplots(2, 1, sharex=True, sharey=True)
    for panel, motor_, title in ((top, printed, "Table A.1 as printed"), (low, device, "as used (E3)")):
        radius = np.degrees(np.arctan(motor_.electromagnet.outer_radius / motor_.electromagnets.distance))
        turn = np.linspace(0, 2 * np.pi, 90)
        for n, frame in enumerate(motor_.electromagnets.frames):
            rim = frame[:, 2] + np.tan(np.radians(radius)) * (
                np.outer(np.cos(turn), frame[:, 0]) + np.outer(np.sin(turn), frame[:, 1])
            )
            lat, lon = _angles(rim / np.linalg.norm(rim, axis=1, keepdims=True))
            (height,), (middle,) = _angles(frame[None, :, 2])
            middle = middle % 360
            panel.plot((lon - middle + 180) % 360 - 180 + middle, lat, f"C{n // 8}", lw=1.2)
            panel.text(middle, height + 5, str(n + 1), ha="center", va="center", fontsize=8)
        lat, lon = _angles(motor_.sensor_layout.directions)
        panel.plot(lon % 360, lat, "k.", ms=3)
        panel.set(ylabel="latitude [°]", aspect="equal", xlim=(-25, 362))
        panel.set_title(f"{title}: rims of the electromagnets, sensors as dots", loc="left", fontsize=10)
    low.set_xlabel("longitude [°]")
    figure.savefig(path, dpi=120)
    return path
