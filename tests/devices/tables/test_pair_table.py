"""Pair tables against the exact model, their kernels, and their file on disk."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import haptorb
from haptorb import compiled
from haptorb.devices import table_cache, tables
from haptorb.devices import tables as table_kernels
from haptorb.devices.base import rotation_to_axis
from haptorb.devices.tables import PairTable, field_table, torque_table
from haptorb.errors import GeometryError, InputError, PrecisionError
from haptorb.magnetics import magnets as cylinder
from haptorb.magnetics import magnets as ring
from haptorb.magnetics.coil import Coil
from haptorb.magnetics.interaction import wrench
from haptorb.magnetics.magnets import CylinderMagnet, RingMagnet
from haptorb.magnetics.source import PlacedSource
from oracles.magnetics.source_sum import SourceSum

MAGNET = CylinderMagnet(15.875e-3, 5.08e-3, 1.31)
COIL = Coil(1000, 0.3 * 15.88e-3, 15.88e-3, 7.62e-3)
R_PM, R_EM, R_SENSOR = 67.9e-3, 56.8e-3, 62.4e-3


def axes(latitude: float, longitudes: np.ndarray) -> np.ndarray:
    lat, lon = np.deg2rad(latitude), np.deg2rad(longitudes)
    return np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.full_like(lon, np.sin(lat))], axis=1)


MAGNETS = np.concatenate([axes(-15, 30.0 * np.arange(12)), axes(15, 30.0 * np.arange(12))])
STRENGTH = np.concatenate([(-1.0) ** np.arange(12), -((-1.0) ** np.arange(12))])
COILS = np.concatenate(
    [axes(-26, 45.0 * np.arange(8) + 22.5), axes(26, 45.0 * np.arange(8) + 22.5), axes(0, 45.0 * np.arange(8))]
)
SENSORS = np.concatenate([axes(latitude, 22.5 * np.arange(16)) for latitude in (-26, 26, 0)])
R0 = Rotation.from_euler("XYZ", [10, 5, 5], degrees=True).as_matrix()


@pytest.fixture(scope="module")
def torque() -> PairTable:
    return torque_table(MAGNET, R_PM, COIL, R_EM)


@pytest.fixture(scope="module")
def field() -> PairTable:
    return field_table(MAGNET, R_PM, R_SENSOR)


def rotor(R: np.ndarray) -> SourceSum:
    """All magnets in the stator frame, at the exact model."""
    return SourceSum(
        [
            PlacedSource(CylinderMagnet(15.875e-3, 5.08e-3, 1.31 * s), R_PM * (R @ u), rotation_to_axis(R @ u))
            for u, s in zip(MAGNETS, STRENGTH, strict=True)
        ]
    )


def characteristic(table: PairTable, R: np.ndarray, magnets: np.ndarray = MAGNETS) -> np.ndarray:
    out = np.empty((len(R), 3, len(COILS)))
    table_kernels.torque_characteristic(table.cells, table.scale, magnets, STRENGTH, COILS, R, out)
    return out


def readings(table: PairTable, R: np.ndarray) -> np.ndarray:
    out = np.empty((len(R), len(SENSORS), 3))
    table_kernels.sensor_field(table.cells, table.scale, MAGNETS, STRENGTH, SENSORS, R, out)
    return out


@pytest.mark.parametrize(
    ("coil", "published"),
    [
        (16, (0.0, -0.188419, 0.026007)),
        (0, (0.072417, 0.031309, 0.161740)),
        (8, (0.076864, -0.036335, -0.117090)),
    ],
)
def test_known_characteristic_from_table_and_exact_level(torque, coil, published):
    table = characteristic(torque, R0[None])[0, :, coil]
    on_coil = wrench(
        rotor(R0), COIL, R_EM * COILS[coil], rotation_to_axis(COILS[coil]), about=(0, 0, 0), precision=1e-7
    )
    assert table == pytest.approx(published, abs=1e-6)
    assert -on_coil.value[3:] == pytest.approx(published, abs=1e-6)
    assert table == pytest.approx(-on_coil.value[3:], abs=1e-8)


def test_peaks_on_the_published_trajectory(torque):
    t = np.linspace(0, 2 * np.pi, 721)
    angles = np.stack([10 * np.sin(t), 5 * np.sin(t), np.full_like(t, 5.0)], axis=1)
    K = characteristic(torque, Rotation.from_euler("XYZ", angles, degrees=True).as_matrix())[:, :, 16]
    assert np.abs(K[:, 1]).max() == pytest.approx(0.21063, abs=2e-5)
    assert np.abs(K[:, 2]).max() == pytest.approx(0.02601, abs=2e-5)


def test_sensor_field_is_the_exact_field(field):
    R = Rotation.random(20, random_state=1).as_matrix()
    table = readings(field, R)
    exact = np.array([rotor(each).field(R_SENSOR * SENSORS) for each in R])
    assert np.abs(table - exact).max() < 1e-7 * np.abs(exact).max()


def test_values_of_one_pair_follow_the_exact_level(torque):
    angles = np.array([0.003, 0.05, 0.21, 0.4, 0.9, 2.0, 3.1])
    k, slope = torque.values(np.cos(angles))
    for angle, value in zip(angles, k[0], strict=True):
        u = np.array([np.sin(angle), 0, np.cos(angle)])
        placed = PlacedSource(MAGNET, R_PM * u, rotation_to_axis(u))
        found = wrench(placed, COIL, (0, 0, R_EM), np.eye(3), about=(0, 0, 0), precision=1e-10).value[4] / np.sin(angle)
        assert value == pytest.approx(found, abs=1e-8 * np.abs(k).max())
    step = 1e-6
    ahead, behind = torque.values(np.cos(angles) + step)[0], torque.values(np.cos(angles) - step)[0]
    inner = slice(1, -1)
    assert slope[0, inner] == pytest.approx((ahead - behind)[0, inner] / (2 * step), rel=1e-4, abs=1e-6)


def test_derivatives_by_rotation_are_those_of_the_values(field):
    R = Rotation.random(50, random_state=2).as_matrix()
    B, dB = np.empty((50, 48, 3)), np.empty((50, 48, 3, 3))
    table_kernels.sensor_field_gradient(field.cells, field.scale, MAGNETS, STRENGTH, SENSORS, R, B, dB)
    assert pytest.approx(readings(field, R), abs=1e-14) == B
    h = 1e-5
    for a in range(3):
        turn = Rotation.from_rotvec(h * np.eye(3)[a]).as_matrix()
        along = (readings(field, turn @ R) - readings(field, turn.T @ R)) / (2 * h)
        assert np.abs(dB[..., a] - along).max() < 1e-7 * np.abs(dB).max()


def test_magnet_right_over_a_coil_and_opposite_to_it_is_ordinary(torque, field):
    u = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    strength, here = np.ones(2), np.array([[1.0, 0, 0]])
    out = np.empty((1, 3, 1))
    table_kernels.torque_characteristic(torque.cells, torque.scale, u, strength, here, np.eye(3)[None], out)
    assert np.abs(out).max() == 0.0
    B, dB = np.empty((1, 1, 3)), np.empty((1, 1, 3, 3))
    table_kernels.sensor_field_gradient(field.cells, field.scale, u, strength, here, np.eye(3)[None], B, dB)
    assert np.isfinite(dB).all()
    on_axis = MAGNET.field((0, 0, R_SENSOR - R_PM))[2] - MAGNET.field((0, 0, -R_SENSOR - R_PM))[2]
    assert B[0, 0] == pytest.approx((on_axis, 0, 0), abs=1e-8)


def test_periodic_in_sixty_degrees_and_antiperiodic_in_thirty(torque, field):
    R = Rotation.from_euler("XYZ", [[8, -13, 17]], degrees=True).as_matrix()
    for angle, sign in ((60, 1), (30, -1)):
        spun = R @ Rotation.from_euler("Z", angle, degrees=True).as_matrix()
        assert characteristic(torque, spun) == pytest.approx(sign * characteristic(torque, R), abs=1e-12)
        assert readings(field, spun) == pytest.approx(sign * readings(field, R), abs=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_a_broken_orientation_gives_nothing_finite_and_harms_nothing(torque, field, bad):
    R = np.array([np.full((3, 3), bad), np.eye(3)])
    K, B = characteristic(torque, R), readings(field, R)
    if not np.isfinite(bad):
        assert not np.isfinite(K[0]).any()
        assert not np.isfinite(B[0]).any()
    assert np.isfinite(K[1]).all()


def test_ring_magnets_have_tables_too():
    ring = RingMagnet(12e-3, 6e-3, 5e-3, 1.2)
    table = field_table(ring, 50e-3, 42e-3)
    u, s = np.array([np.sin(0.3), 0, np.cos(0.3)]), np.array([0, 0, 1.0])
    f, g = table.values(np.array(np.cos(0.3)))[0]
    exact = PlacedSource(ring, 50e-3 * u, rotation_to_axis(u)).field(42e-3 * s)
    assert f * u + g * s == pytest.approx(exact, abs=1e-8)


def test_progress_is_told_and_ends_complete():
    told: list[tuple[int, int]] = []
    torque_table(MAGNET, R_PM, COIL, 45e-3, precision=1e-4, progress=lambda done, total: told.append((done, total)))
    assert [done for done, _ in told] == list(range(1, len(told) + 1))
    assert told[-1][0] == told[-1][1]


def test_what_cannot_be_tabulated_is_refused():
    with pytest.raises(GeometryError, match="pass through"):
        field_table(MAGNET, R_PM, R_PM)
    with pytest.raises(GeometryError, match="overlap"):
        torque_table(MAGNET, R_PM, COIL, R_PM - 1e-3, precision=1e-4)
    with pytest.raises(PrecisionError, match="angles is precise"):
        field_table(MAGNET, R_PM, float(np.hypot(R_PM + 2.54e-3, 15.875e-3)) + 1e-6)  # grazes the outer edge
    for wrong in (0.0, 1.0, np.nan, -1e-3):
        with pytest.raises(InputError):
            field_table(MAGNET, R_PM, R_SENSOR, precision=wrong)
    with pytest.raises(InputError, match="magnet_distance"):
        field_table(MAGNET, -R_PM, R_SENSOR)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "haptorb" / "tables"


def load_table(precision: float = 1e-4) -> PairTable:
    return table_cache.load_field_table(MAGNET, R_PM, 50e-3, precision=precision)


def forbid(monkeypatch) -> None:
    def fail(*args: object, **kwargs: object) -> PairTable:
        raise AssertionError("computed again")

    monkeypatch.setattr(tables, "field_table", fail)


def test_a_kept_table_is_read_back_bit_for_bit(folder, monkeypatch):
    first = load_table()
    forbid(monkeypatch)
    again = load_table()
    assert (again.cells == first.cells).all()
    assert (again.scale, again.bound) == (first.scale, first.bound)
    assert len(list(folder.iterdir())) == 1


def test_another_body_distance_or_precision_is_another_table(folder):
    load_table()
    load_table(1e-3)
    table_cache.load_field_table(MAGNET, R_PM, 51e-3, precision=1e-4)
    table_cache.load_field_table(CylinderMagnet(15.875e-3, 5.08e-3, 1.3100000000000003), R_PM, 50e-3, precision=1e-4)
    assert len(list(folder.iterdir())) == 4


def test_the_code_of_all_that_makes_a_tables_numbers_is_in_its_name():
    package, seen = Path(haptorb.__file__).parent, set()
    waiting = [Path(module.__file__) for module in (tables, cylinder, ring)]
    while waiting:
        file = waiting.pop()
        if file not in seen:
            seen.add(file)
            waiting.extend(compiled._neighbours(file)[1])
    imported = {file.relative_to(package).with_suffix("").as_posix() for file in seen if file.stem != "__init__"}
    makers = {Path(module.__file__).relative_to(package).with_suffix("").as_posix() for module in table_cache._MAKERS}
    assert makers == imported - {
        *("errors", "arrays", "compiled", "_numba_patches", "cache_folder", "lazy_names"),
        "magnetics/soft_sphere",  # of a coil that is centred on a sphere; no table is of one
    }


@pytest.mark.parametrize("damage", ["empty", "torn", "bit", "scale", "foreign", "binary", "list"])
def test_a_damaged_or_foreign_file_is_found_and_made_again(folder, damage):
    first = load_table()
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    head, numbers = whole.split(b"\n", 1)
    flipped = bytes([numbers[100] ^ 1])
    path.write_bytes(
        {
            "empty": b"",
            "torn": whole[:-9],
            "bit": head + b"\n" + numbers[:100] + flipped + numbers[101:],
            "scale": head.replace(b'"scale": 1', b'"scale": 9') + b"\n" + numbers,
            "foreign": b'{"name": "other"}\n' + numbers,
            "binary": os.urandom(5000),
            "list": b"[1, 2]\n" + numbers,
        }[damage]
    )
    assert path.read_bytes() != whole
    again = load_table()
    assert (again.cells == first.cells).all()
    assert again.scale == first.scale
    assert path.read_bytes() == whole


def test_a_sound_table_under_another_tables_name_is_not_believed(folder):
    first = load_table()
    (path,) = folder.iterdir()
    table_cache.load_field_table(MAGNET, R_PM, 51e-3, precision=1e-4)
    (other,) = set(folder.iterdir()) - {path}
    path.write_bytes(other.read_bytes())
    assert (load_table().cells == first.cells).all()


def test_a_cache_that_cannot_be_written_costs_time_only(tmp_path, monkeypatch):
    (tmp_path / "haptorb").write_text("a file where the folder should be")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert load_table().bound < 1e-3
