"""`haptorb bench magnetics`: torque of all coils and field at all sensors of the spherical motor, by all libraries.

The reference is an independent closed form (magpylib.core) over a much finer winding, else this library's exact model.
"""

from __future__ import annotations

import platform
from collections.abc import Callable
from importlib import metadata
from importlib.util import find_spec

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.api import motor, sensor_field, torque_characteristic
from haptorb.devices.loader import load
from haptorb.devices.motor_wrench_map import exact_field, exact_torque
from haptorb.rotations import rotation_from_euler
from haptorb_bench import peers
from haptorb_bench.contest import Contest, Result, measure_fastest
from haptorb_bench.result import Metric

__all__ = ["magnetics", "rows"]

_BATCH = 2000  #: orientations in a batch
_FILAMENTS = (3, 2, 36)  #: across, along, around: what peers use
_COARSE = (2, 1, 18)  #: a quarter of that, for a peer that gains by it
_FINE = (10, 6, 108)  #: what the reference uses: converged to 1e-7


def magnetics(device: str = "pmsm", budget: float = 0.5, report: Callable[[str], None] | None = None) -> Contest:
    """Run the comparison on `device`, `budget` seconds per row; `report` receives the name of what is running."""
    notify = report or (lambda text: None)
    known = motor(load(device))
    R = rotation_from_euler(np.radians(10.0), np.radians(5.0), np.radians(5.0))
    spread = np.random.default_rng(0)
    psi, lam = spread.uniform(-known.workspace_tilt, known.workspace_tilt, (2, _BATCH))
    many = rotation_from_euler(psi, lam, spread.uniform(0, 2 * np.pi, _BATCH))
    many[0] = R
    sensors = known.sensor_layout.positions
    with_magpylib, with_cfsem = find_spec("magpylib") is not None, find_spec("cfsem") is not None

    notify("reference")
    if with_magpylib:
        torque = peers.Winding(known, *_FINE).torque(peers.core_field(known, R))
        field = peers.core_field(known, R)(sensors)
    else:
        torque, field = exact_torque(known, R[None])[0], exact_field(known, R[None], sensors)[0]

    rows: list[Result] = []

    def run(task: str, who: str, how: str, work: Callable[[], Array] | None, truth: Array, per_call: int = 1) -> None:
        notify(f"{who}: {how}")
        if work is None:
            rows.append(Result(task, who, how, None, None))
            return
        value = work()
        result = value[0] if per_call > 1 else value
        error = float(np.abs(result - truth).max() / np.abs(truth).max())
        rows.append(Result(task, who, how, measure_fastest(work, per_call, budget), error))

    task = f"torque per ampere of all {len(known.electromagnets)} coils, one orientation"
    winding = peers.Winding(known, *_FILAMENTS)
    run(task, "haptorb", f"table, batch of {_BATCH}", lambda: torque_characteristic(known, many), torque, _BATCH)
    run(task, "haptorb", "table, one call", lambda: torque_characteristic(known, R), torque)
    run(task, "haptorb", "exact to 1e-7", lambda: torque_characteristic(known, R, "exact"), torque)
    run(
        task,
        "haptorb",
        "exact field, same filaments",
        lambda: winding.torque(lambda at: exact_field(known, R[None], at)[0]),
        torque,
    )
    run(task, "haptorb", "published multipoles", lambda: torque_characteristic(known, R, "published"), torque)
    core = peers.core_field(known, R) if with_magpylib else None
    run(task, "magpylib", "core in blocks", None if core is None else lambda: winding.torque(core), torque)
    run(
        task,
        "magpylib",
        "getFT, one batch",
        peers.getft_torque(known, R, *_FILAMENTS) if with_magpylib else None,
        torque,
    )
    coarse = peers.getft_torque(known, R, *_COARSE) if with_magpylib else None
    run(task, "magpylib", "getFT, coarser winding", coarse, torque)
    cfsem = peers.cfsem_field(known, R) if with_cfsem else None
    run(task, "cfsem", "magnets as 16 loops", None if cfsem is None else lambda: winding.torque(cfsem), torque)

    task = f"field at all {known.sensors} sensors, one orientation"
    run(task, "haptorb", f"table, batch of {_BATCH}", lambda: sensor_field(known, many), field, _BATCH)
    run(task, "haptorb", "table, one call", lambda: sensor_field(known, R), field)
    run(task, "haptorb", "exact", lambda: sensor_field(known, R, "exact"), field)
    run(task, "magpylib", "core in blocks", None if core is None else lambda: core(sensors), field)
    objects = peers.getb_field(known, R) if with_magpylib else None
    run(task, "magpylib", "getB", None if objects is None else lambda: objects(sensors), field)
    run(task, "cfsem", "magnets as 16 loops", None if cfsem is None else lambda: cfsem(sensors), field)
    return Contest(f"Magnetics of '{known.name}', one thread", tuple(rows), _machine())


def rows(effort: float, notify: Callable[[str], None]) -> list[Metric]:
    """The contest as rows: the table in one call against each peer's own way, [µs] per orientation."""
    contest = magnetics(budget=0.5 * effort, report=notify)
    out = []
    for task in dict.fromkeys(result.task for result in contest.results):
        mine = [result for result in contest.results if result.task == task]
        table = next(result for result in mine if result.how == "table, one call")
        own = 1e6 * (table.seconds or 0.0)
        peers_ = [result for result in mine if result.who != "haptorb" and result.seconds is not None]
        what = task.removesuffix(", one orientation")
        if not peers_:
            out.append(Metric("magnetics", what, own, "µs", note="no peer is installed"))
        for peer in peers_:
            note = f"relative error {table.error:.0e} here, {peer.error:.0e} there"
            out.append(
                Metric("magnetics", what, own, "µs", f"{peer.who}, {peer.how}", 1e6 * (peer.seconds or 0.0), note=note)
            )
    return out


def _machine() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for package in ("haptorb", "numpy", "numba", "magpylib", "cfsem"):
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return versions
