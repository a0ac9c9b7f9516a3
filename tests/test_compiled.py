"""Kernels before the compiler is loaded: compiled at the first call, with identical results."""

from __future__ import annotations

import gc
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptorb._numba_patches import compile_function
from haptorb.arrays import Array
from haptorb.compiled import PostponedKernel, kernel, load_compiler, tick_kernel
from haptorb.devices import electromagnet_wrench_map

PROGRAM = """
import sys
import numpy as np
from haptorb.devices import electromagnet_wrench_map
from haptorb.magnetics import dipole
from haptorb.magnetics.dipole import dipole_per_ampere
from haptorb.compiled import PostponedKernel

assert "numba" not in sys.modules
assert type(dipole_per_ampere) is PostponedKernel
assert "point dipole" in dipole_per_ampere.__doc__
K = np.empty((6, 1))
dipole_per_ampere(2.407, np.array([[0.0], [0.0], [0.2077]]), np.array([0.0, 0.0, 0.05]), np.eye(3), K)
assert "numba" in sys.modules
held = [key for module in list(sys.modules.values()) if module.__name__.startswith("haptorb")
        for key, value in vars(module).items() if type(value) is PostponedKernel]
# What was imported before keeps its value, and so do modules that are read from here on.
from haptorb.magnetics import current_sheets
dipole_per_ampere(2.407, np.array([[0.0], [0.0], [0.2077]]), np.array([0.0, 0.0, 0.05]), np.eye(3), K)
kinds = [type(one).__name__ for one in (dipole.dipole_per_ampere, current_sheets.zonal)]
print(round(-1e3 * float(K[2, 0]), 1), held, *kinds)
"""


def output_of(program: str) -> str:
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_the_first_call_loads_the_compiler_for_all_kernels() -> None:
    assert output_of(PROGRAM) == "48.0 [] CPUDispatcher CPUDispatcher"


def test_a_source_that_is_edited_before_the_first_call_is_another_state(tmp_path: Path) -> None:
    program = """
import sys
from pathlib import Path
from haptorb import compiled
compiled._PACKAGE = Path(sys.argv[1])
sys.path.insert(0, sys.argv[1])
import double
source = Path(sys.argv[1], "double.py")
source.write_text(source.read_text().replace("2.0", "3.0"))
print(double.double(1.0))
"""
    source = tmp_path / "double.py"
    (tmp_path / "numerics").mkdir()
    (tmp_path / "numerics" / "compiled.py").touch()
    for expected in ("2.0", "3.0"):
        if not source.exists():
            source.write_text("from haptorb.compiled import kernel\n\n@kernel\ndef double(x):\n    return 2.0 * x\n")
        environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(
            [sys.executable, "-c", program, str(tmp_path)], env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout.strip() == expected


def test_it_is_known_whether_a_kernel_is_in_the_cache(tmp_path: Path) -> None:
    program = """
from haptorb.compiled import has_cached_code
from haptorb.magnetics.elliptic_integrals import integrals, third_kind
from haptorb.magnetics.current_sheets import zonal
print(has_cached_code(integrals), integrals(0.5, 0.75)[0] > 0.0, has_cached_code(integrals), has_cached_code(zonal))
"""
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment["XDG_CACHE_HOME"] = str(tmp_path)
    for before in ("False", "True"):
        done = subprocess.run(
            [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False
        )
        assert done.stdout.split() == [before, "True", "True", "False"], done.stderr


@pytest.mark.parametrize(
    "room", ["tick", "drivers.sim", "drivers.serial", "drivers.i2c", "loop", "trackers.tracker_process"]
)
def test_what_runs_beside_a_clock_has_the_compiler_loaded(room: str) -> None:
    assert output_of(f"import sys, haptorb.runtime.{room}; print('numba' in sys.modules)") == "True"


@pytest.mark.parametrize("room", ["recorder_process", "servo"])
def test_what_compiles_nothing_is_there_without_the_compiler(room: str) -> None:
    assert output_of(f"import sys, haptorb.runtime.{room}; print('numba' in sys.modules)") == "False"


def test_a_postponed_kernel_can_be_called_by_others_and_sent_elsewhere() -> None:
    from numba import njit

    postponed = PostponedKernel(electromagnet_wrench_map.axis_frame.py_func)  # type: ignore[attr-defined]
    assert postponed.__wrapped__ is electromagnet_wrench_map.axis_frame.py_func  # type: ignore[attr-defined]
    assert not hasattr(postponed, "_not_there")

    @njit  # type: ignore[untyped-decorator]
    def turn(axis, R):
        postponed(axis, R)
        return R[2, 2]

    assert turn(np.array([0.0, 0.0, 1.0]), np.empty((3, 3))) == 1.0
    R = np.empty((3, 3))
    pickle.loads(pickle.dumps(postponed))(np.array([1.0, 0.0, 0.0]), R)
    assert R[:, 2].tolist() == [1.0, 0.0, 0.0]


def test_a_kernel_is_compiled_once_for_all_constants_that_others_pass() -> None:
    from numba import njit
    from numba.core.dispatcher import Dispatcher

    load_compiler()
    double: Any = kernel(_double)

    def total() -> int:
        return double(1) + double(2) + double(3)  # type: ignore[no-any-return]

    compiled: Any = njit(total)  # without a cache, so that what it calls is compiled now
    assert compiled() == 12
    # by its type: isinstance asks weak proxies of others for the class of what they stood for
    found = [one for one in gc.get_objects() if issubclass(type(one), Dispatcher)]
    dispatchers = [one for one in found if one.py_func is _double]
    assert [str(types) for one in dispatchers for types in one.signatures] == ["(int64,)"]


def _double(number: int) -> int:
    return 2 * number


def _add_up(values: Array) -> float:
    total = np.zeros(1)
    for value in values:
        total[0] += value
    return float(total[0])


_kernel_with_array: Any = kernel(_add_up)


def _add_up_twice(values: Array) -> float:
    return 2.0 * float(_kernel_with_array(values))


def _fill_new(value: float) -> float:
    new = np.full(3, value)
    return float(new[0])


def test_a_tick_kernel_makes_no_array_but_may_call_one_that_does() -> None:
    from numba.core.errors import TypingError

    load_compiler()
    assert tick_kernel(_add_up_twice)(np.array([1.0, 2.0])) == 6.0
    with pytest.raises(TypingError, match="array"):
        tick_kernel(_fill_new)(2.0)


def _subtract_product(a: float, b: float, c: float) -> float:
    return a * b - c


def test_the_compiler_may_reorder_and_fuse_nothing_in_an_exact_kernel() -> None:
    load_compiler()
    for exact in (True, False):
        compiled = compile_function(_subtract_product, "", exact=exact)
        assert compiled(0.5, 3.0, 1.0) == 0.5
        text = "".join(compiled.inspect_llvm().values())
        assert ("reassoc" in text or "contract" in text) is not exact


LINEAR_ALGEBRA = """
import sys
import numba, numpy as np
from haptorb.rotations import turn_by
turn_by(0.1, 0.2, 0.3, np.eye(3), np.empty((3, 3)))
before = "scipy.linalg" in sys.modules
@numba.njit
def product(a, b):
    return a @ b
print(before, product(2 * np.eye(2), np.eye(2))[0, 0])
"""


def test_linear_algebra_is_loaded_by_those_who_need_it_only():
    done = subprocess.run([sys.executable, "-c", LINEAR_ALGEBRA], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "2.0"]
