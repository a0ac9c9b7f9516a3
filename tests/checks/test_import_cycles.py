"""No import cycles between modules or packages."""

from __future__ import annotations

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOTS = {"src": ROOT / "src", "papers": ROOT / "papers", "benchmarks/haptorb_bench": ROOT / "benchmarks"}


def _imports() -> dict[str, set[str]]:
    """Module → modules of haptorb that it imports anywhere, for types only too."""
    files = {
        path: ".".join(path.relative_to(root).with_suffix("").parts)
        for folder, root in ROOTS.items()
        for path in (ROOT / folder).rglob("*.py")
    }
    modules = {path: name.removesuffix(".__init__") for path, name in files.items()}
    known = set(modules.values())
    found: dict[str, set[str]] = {}
    for path, module in modules.items():
        names = found.setdefault(module, set())
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                inside = {f"{node.module}.{alias.name}" for alias in node.names}
                names.update(name if name in known else node.module for name in inside)
        names &= known - {module}
    return found


def _child(module: str, package: str) -> str:
    """The module or package directly inside `package` to which `module` belongs; "" if it stands outside."""
    return f"{package}.{module[len(package) + 1 :].split('.')[0]}" if module.startswith(f"{package}.") else ""


def test_imports_make_no_circle_those_for_types_counted_too() -> None:
    """Neither between modules nor between what stands side by side in any package."""
    imports = _imports()
    packages = {module.rpartition(".")[0] for module in imports} - {""}
    for package in sorted(packages):
        graph: dict[str, set[str]] = {}
        for module, others in imports.items():
            if child := _child(module, package):
                inside = {_child(other, package) for other in others} - {"", child}
                graph.setdefault(child, set()).update(inside)
        try:
            list(TopologicalSorter(graph).static_order())
        except CycleError as circle:
            pytest.fail(" → ".join(circle.args[1]))
