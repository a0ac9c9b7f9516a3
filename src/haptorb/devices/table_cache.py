"""Cache of pair tables on disk, named by a hash of their inputs.

A table's name is a hash of the bodies, distances and precision and of the code that computes them, so a changed magnet
or a changed formula never meets an old table. A file is one line of JSON (name, shape, scale, bound, hash of the
numbers) and the numbers; anything that does not fit is treated as absent and written again. A folder that cannot be
written costs time, never an error.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from haptorb.cache_folder import cache_folder
from haptorb.devices import tables
from haptorb.devices.tables import PairTable, Progress
from haptorb.errors import DeviceError
from haptorb.files import read_bytes, replace_file
from haptorb.magnetics import coil, current_sheets, dipole, elliptic_integrals, interaction, magnets, source
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.source import RoundBody

__all__ = ["load_field_table", "load_torque_table"]

_MAX_TABLE_BYTES = 64 * 1024 * 1024  #: bytes of a table

#: modules whose code determines a table's values: `devices.tables`, the magnets, and what they import, except what
#: only passes values on
_MAKERS = (tables, interaction, coil, current_sheets, elliptic_integrals, magnets, dipole, source)


def load_torque_table(
    magnet: RoundBody,
    magnet_distance: float,
    winding: Coil,
    coil_distance: float,
    *,
    precision: float = 1e-8,
    progress: Progress | None = None,
) -> PairTable:
    """Load `tables.torque_table` from the cache on disk; compute and store it if it is missing."""
    made_from = (
        f"torque {magnet!r} {float(magnet_distance)!r} {winding!r} {float(coil_distance)!r} {float(precision)!r}"
    )
    return _load_or_build(
        made_from,
        1,
        lambda: tables.torque_table(
            magnet, magnet_distance, winding, coil_distance, precision=precision, progress=progress
        ),
    )


def load_field_table(
    magnet: RoundBody,
    magnet_distance: float,
    sensor_distance: float,
    *,
    precision: float = 1e-8,
    progress: Progress | None = None,
) -> PairTable:
    """Load `tables.field_table` from the cache on disk; compute and store it if it is missing."""
    made_from = f"field {magnet!r} {float(magnet_distance)!r} {float(sensor_distance)!r} {float(precision)!r}"
    return _load_or_build(
        made_from,
        2,
        lambda: tables.field_table(magnet, magnet_distance, sensor_distance, precision=precision, progress=progress),
    )


@cache
def _code() -> bytes:
    digest = hashlib.sha256()
    for module in _MAKERS:
        assert module.__file__ is not None
        digest.update(Path(module.__file__).read_bytes())
    return digest.digest()


def _load_or_build(made_from: str, functions: int, build: Callable[[], PairTable]) -> PairTable:
    name = hashlib.sha256(made_from.encode() + _code()).hexdigest()[:32]
    path = cache_folder() / "tables" / f"{name}.table"
    table = _read(path, name, functions)
    if table is None:
        table = build()
        with contextlib.suppress(OSError):
            _write(path, name, table)
    return table


def _read(path: Path, name: str, functions: int) -> PairTable | None:
    """The table in `path`, or None if it is absent, torn, altered, or not this one."""
    try:
        head, _, numbers = read_bytes(path, _MAX_TABLE_BYTES, "table", DeviceError).partition(b"\n")
        header = json.loads(head)
        rows, columns = header["shape"]
        sound = (
            header["name"] == name
            and columns == 6 * functions
            and rows > 1
            and len(numbers) == 8 * rows * columns
            and header["sha256"] == _digest(numbers, header["scale"], header["bound"])
        )
        if not sound:
            return None
        cells = np.frombuffer(numbers, dtype="<f8").reshape(rows, columns).astype(np.float64)
        return PairTable(cells, float(header["scale"]), float(header["bound"]))
    except (DeviceError, ValueError, KeyError, TypeError, RecursionError, OverflowError):
        return None


def _digest(numbers: bytes, scale: float, bound: float) -> str:
    return hashlib.sha256(numbers + f"{scale!r} {bound!r}".encode()).hexdigest()


def _write(path: Path, name: str, table: PairTable) -> None:
    numbers = table.cells.astype("<f8").tobytes()
    head = {
        "name": name,
        "shape": list(table.cells.shape),
        "scale": table.scale,
        "bound": table.bound,
        "sha256": _digest(numbers, table.scale, table.bound),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(path) as part:
        part.write_bytes(json.dumps(head).encode() + b"\n" + numbers)
