"""Patches of numba's internals change no result, and without them the program runs and computes the same."""

from __future__ import annotations

import json
import math
import operator
import os
import re
import subprocess
import sys
import tomllib
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from haptorb._numba_patches import NEWEST, is_patched
from haptorb.arrays import Array, Record
from haptorb.compiled import load_compiler
from haptorb.estimation import hall_tracker

PLAIN = "HAPTORB_PLAIN_NUMBA"


@pytest.fixture(autouse=True)
def _leave_the_environment(monkeypatch: pytest.MonkeyPatch) -> Any:
    """`is_patched` tells its children; these tests' verdicts are not for others."""
    monkeypatch.setenv(PLAIN, "0")
    is_patched.cache_clear()
    yield
    is_patched.cache_clear()


def test_the_newest_version_is_that_of_the_installation(root: Path) -> None:
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    (bound,) = (one for one in project["dependencies"] if one.startswith("numba"))
    low, high = re.fullmatch(r"numba>=0\.(\d+),<0\.(\d+)", bound).groups()  # type: ignore[union-attr]
    assert (0, int(high) - 1) == NEWEST
    assert is_patched(f"0.{low}.0")
    assert is_patched(f"0.{NEWEST[1]}.9rc1")


@pytest.mark.parametrize("version", ["0.69.0", "0.70.0rc1", "1.0", "2.0.0"])
def test_a_newer_numba_is_used_as_it_is_and_both_versions_are_named(
    version: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert not is_patched(version)
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert version in said
    assert ".".join(map(str, NEWEST)) in said
    is_patched.cache_clear()
    assert not is_patched(version)  # as in a process that this one starts
    assert capsys.readouterr().err == ""


PROGRAM = """
import json
import numpy as np
from haptorb.compiled import load_compiler
from haptorb.magnetics import dipole as dipoles

load_compiler()
from numba.core import codegen
from numba.core.types.functions import BaseFunction

dipole = dipoles.dipole_per_ampere
K = np.empty((6, 3))
dipole(2.407, np.diag([0.1, 0.15, 0.2]), np.array([0.01, 0.02, 0.05]), np.eye(3), K)
changed = ["__wrapped__" in vars(BaseFunction.get_call_type),
           codegen.CPUCodeLibrary._finalize_final_module.__module__.startswith("haptorb"),
           dipole.get_call_template.__module__.startswith("haptorb"),
           codegen.JITCodeLibrary.serialize_using_object_code.__module__.startswith("haptorb")]
print(json.dumps({"K": K.tolist(), "changed": changed}))
"""


def test_without_changes_none_is_made_and_a_kernel_computes_the_same(tmp_path: Path) -> None:
    plain, patched = (_run("-c", PROGRAM, plain=plain, cache=tmp_path) for plain in ("1", ""))
    assert plain["changed"] == [False] * 4
    assert patched["changed"] == [True] * 4
    np.testing.assert_allclose(plain["K"], patched["K"], rtol=1e-12)


@pytest.mark.parametrize("plain", ["1", ""])
def test_where_compiling_is_forbidden_a_kernel_is_named_in_either_way(plain: str, tmp_path: Path) -> None:
    program = """
import json, sys
from pathlib import Path
from haptorb import compiled
compiled._PACKAGE = Path(sys.argv[1])
sys.path.insert(0, sys.argv[1])
import double
heard = []
compiled.on_compiling(lambda: heard.append(1))
with compiled.forbid_compiling() as missing:
    try:
        double.double(1.0)
    except compiled.UncompiledKernelError as error:
        said = str(error)
silent = len(heard)
double.double(1.0)
with compiled.forbid_compiling():
    double.double(2.0)
print(json.dumps([said, missing, silent, len(heard)]))
"""
    (tmp_path / "double.py").write_text(
        "from haptorb.compiled import kernel\n\n@kernel\ndef double(x):\n    return x\n"
    )
    said, missing, silent, heard = _run("-c", program, str(tmp_path), plain=plain, cache=tmp_path / "cache")
    assert "'double.double' is not compiled" in said
    assert (missing, silent, heard) == (["double.double"], 0, 1)


CALLER = """
import json, sys
from pathlib import Path
from haptorb import compiled
compiled._PACKAGE = Path(sys.argv[1])
sys.path.insert(0, sys.argv[1])
import roots
said = []
for number in (4.0, -1.0):
    try:
        said.append(roots.twice_root(number))
    except ValueError as error:
        said.append(str(error))
said.append(roots.half_root(4.0) if "half" in sys.argv else 0.0)
said.append(roots.root(9.0) if "root" in sys.argv else 0.0)
print(json.dumps(said))
"""


@pytest.mark.parametrize("plain", [pytest.param("1", marks=pytest.mark.slow), ""])
def test_a_called_kernel_computes_and_raises_also_where_it_is_taken_from_the_cache(plain: str, tmp_path: Path) -> None:
    (tmp_path / "roots.py").write_text("""
import math
from haptorb.compiled import kernel

@kernel
def root(x):
    if x < 0.0:
        raise ValueError("no root of a negative number")
    return math.sqrt(x)

@kernel
def twice_root(x):
    return 2.0 * root(x)

@kernel
def half_root(x):
    return 0.5 * root(x)
""")
    for wanted in ((), (), ("half",), ("half",), ("half", "root")):  # each but the first finds the earlier code
        said = _run("-c", CALLER, str(tmp_path), *wanted, plain=plain, cache=tmp_path / "cache")
        expected = [4.0, "no root of a negative number", float("half" in wanted), 3.0 * ("root" in wanted)]
        assert said == expected, wanted


@pytest.mark.slow
@pytest.mark.parametrize("device", ["omni", "pmsm"])
def test_a_recorded_run_is_replayed_without_changes(device: str, tmp_path: Path) -> None:
    """The whole program: it runs, and every number of every tick is that of the changed numba."""
    recorded = tmp_path / "run.mcap"
    run = ("-m", "haptorb", "run", device, "--headless", "--duration", "3", "--json")
    assert _run(*run, "--record", str(recorded), plain="", cache=tmp_path)["ticks"] > 500
    assert _run(*run, plain="1", cache=tmp_path)["ticks"] > 500
    replayed = _run("-m", "haptorb", "replay", str(recorded), "--json", plain="1", cache=tmp_path)
    assert replayed["ticks_compared"] > 2000
    for one in replayed["fields"]:
        assert one["largest_difference"] <= 1e-12 * one["largest_recorded"], one["name"]


def _run(*words: str, plain: str, cache: Path) -> Any:
    """What a program prints as JSON, with a cache of its own; a replay that differs in its last bits ends with 1."""
    environment = os.environ | {PLAIN: plain, "XDG_CACHE_HOME": str(cache)}
    done = subprocess.run([sys.executable, *words], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode in ((0, 1) if "replay" in words else (0,)), done.stderr
    return json.loads(done.stdout)


# --------------------------------------------------------------------------------------------------
# Cached argument types of an operation are those that numba infers.


TWO = (operator.add, operator.mul, operator.truediv, operator.lt, operator.eq, operator.getitem, operator.iadd,
       math.atan2, max)  # fmt: skip
ONE = (operator.neg, operator.not_, math.sqrt, abs, len)


@pytest.mark.parametrize("operation", TWO + ONE, ids=lambda operation: operation.__name__)
def test_first_and_later_answers_are_numba_s(operation: Any) -> None:
    load_compiler()
    from numba import types
    from numba.core.errors import NumbaError
    from numba.core.registry import cpu_target
    from numba.core.types.functions import BaseFunction

    context = cpu_target.typing_context
    context.refresh()
    function = context.resolve_value_type(operation)
    kinds = (types.float64, types.int64, types.boolean, types.IntegerLiteral(3), types.float64[::1], types.float64[:],
             types.float64[:, ::1], types.unicode_type)  # fmt: skip

    def find(how: Any, args: Any) -> Any:
        try:
            found = how(function, context, args, {})
        except (NumbaError, AttributeError):  # the latter: numba of what nobody adds in place
            return None
        return found, function.get_impl_key(found)

    found = 0
    for args in product(kinds, repeat=2 if operation in TWO else 1):
        expected = find(BaseFunction.get_call_type.__wrapped__, args)
        for _ in range(2):
            answer = find(BaseFunction.get_call_type, args)
            assert (answer and answer[0]) == (expected and expected[0])
        found += answer is not None
    assert found


# --------------------------------------------------------------------------------------------------
# Results of a kernel do not depend on the kernels loaded before.


@pytest.fixture(scope="module")
def library() -> Any:
    """Of a kernel that is compiled here, and not loaded, and that calls others which are too long to be inlined."""
    load_compiler()
    from numba import njit

    compiled: Any = njit(hall_tracker.extrapolate_pose.py_func)  # type: ignore[attr-defined]
    believed: Record = np.zeros(1, hall_tracker.FILTER)[0]
    believed["axis"] = 0.0, 0.0, 1.0
    told: tuple[Array, ...] = np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3)
    compiled(believed, 1e-3, *told)
    (result,) = compiled.overloads.values()
    return result.library


def list_defined(module: Any) -> list[tuple[str, str]]:
    """Name and linkage of each function that has code in `module`."""
    return [(one.name, one.linkage.name) for one in module.functions if not one.is_declaration]


def test_a_kernel_calls_its_own_copies_of_others(library: Any) -> None:
    defined = list_defined(library._final_module)
    seen = [name for name, linkage in defined if linkage != "internal"]
    assert seen
    assert [name for name in seen if "extrapolate_pose" not in name] == []
    assert any("axis_frame" in name or "predict" in name for name, linkage in defined if linkage == "internal")


def test_others_are_compiled_from_it_as_ever(library: Any) -> None:
    assert {linkage for _, linkage in list_defined(library._get_module_for_linking())} == {"linkonce_odr"}
