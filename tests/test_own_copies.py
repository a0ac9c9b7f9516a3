"""Results of a kernel do not depend on the kernels loaded before."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from haptorb.arrays import Array, Record
from haptorb.compiled import load_compiler
from haptorb.estimation import hall_tracker


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
