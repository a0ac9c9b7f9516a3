"""The public API: documents, examples and templates use nothing else, and Python and type checkers see the same."""

from __future__ import annotations

import ast
import inspect
import pkgutil
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from haptorb_study.export import make_python_script
from haptorb_study.study_file import study_of
from haptorb_study.template import TEMPLATES, make_study_text

pytestmark = pytest.mark.background

PACKAGES = ("haptorb", "haptorb.worlds", "haptorb.devices", "haptorb.magnetics", "haptorb_study", "haptorb_design")
ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```py(?:thon)?\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)


def programs() -> dict[str, str]:
    """Place → Python code that users read, run or copy."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    skipped = {"_build", "generated", "gallery", "decisions"}
    found = {
        str(page.relative_to(ROOT)): "\n".join(BLOCK.findall(page.read_text(encoding="utf-8")))
        for page in pages
        if not skipped & set(page.parts)
    }
    examples = sorted((ROOT / "examples").rglob("*.py"))
    found |= {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in examples}
    for name in TEMPLATES:
        found[f"analysis of template {name}"] = make_python_script(study_of(make_study_text(name)), "answers.csv")
    return {place: code for place, code in found.items() if code}


def list_uses(code: str) -> list[tuple[str, str]]:
    """(module, name) of every import from haptorb, and of every name taken from an imported package."""
    tree, uses, bound = ast.parse(code), [], {"haptorb": "haptorb"}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0].startswith("haptorb"):
            uses += [(str(node.module), alias.name) for alias in node.names]
            bound |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            names = [alias for alias in node.names if alias.name.partition(".")[0].startswith("haptorb")]
            uses += [(alias.name, "") for alias in names]
            bound |= {alias.asname or "": alias.name for alias in names if alias.asname}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            parts = ast.unparse(node).split(".")
            package = ".".join([bound.get(parts[0], parts[0]), *parts[1:-1]])
            if package in PACKAGES:
                uses.append((package, parts[-1]))
    return uses


def list_faults(code: str) -> list[str]:
    """Uses of what is not public."""
    return [
        f"{module}.{name}".rstrip(".")
        for module, name in list_uses(code)
        if module not in PACKAGES
        or (name and name not in import_module(module).__all__ and f"{module}.{name}" not in PACKAGES)
    ]


@pytest.mark.parametrize(
    ("code", "fault"),
    [
        ("from haptorb.devices.base import State", "haptorb.devices.base.State"),
        ("import haptorb.worlds.base", "haptorb.worlds.base"),
        ("import haptorb\nhaptorb.errors.InputError", "haptorb.errors"),
        ("from haptorb import worlds\nworlds.parameters", "haptorb.worlds.parameters"),
        ("def f():\n    from haptorb_study import feel", "haptorb_study.feel"),
    ],
)
def test_a_use_of_an_internal_name_is_found(code: str, fault: str) -> None:
    assert list_faults(code) == [fault]


def test_documents_and_examples_use_only_the_public_api() -> None:
    found = programs()
    assert {"README.md", "docs/how-to/world.md", "examples/02_how_wrong_is_a_point_dipole.py"} <= set(found)
    assert {place: faults for place, code in found.items() if (faults := list_faults(code))} == {}


def test_documents_use_every_public_package() -> None:
    used = {use for code in programs().values() for use in list_uses(code)}
    assert {module for module, _ in used} == set(PACKAGES)


@pytest.mark.parametrize("package", PACKAGES)
def test_python_and_type_checkers_see_the_same_names(package: str) -> None:
    module = import_module(package)
    tree = ast.parse(inspect.getsource(module))
    imports = {
        alias.asname or alias.name: (node.module, alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("haptorb")
        for alias in node.names
    }
    assert set(module.__all__) <= {*dir(module)}
    for name in module.__all__:
        home, own = imports.get(name, (package, name))
        assert getattr(module, name) is getattr(import_module(str(home)), own), name
    names = set(module.__all__) | {"lazy_names", "__version__"}
    assert package == "haptorb.worlds" or set(imports) <= names, "imported for type checkers, and not public"


@pytest.mark.parametrize("package", PACKAGES)
def test_no_public_name_is_hidden_by_a_module(package: str) -> None:
    """`import haptorb_design.evaluate` binds the module to that name of the package."""
    module = import_module(package)
    assert set(module.__all__).isdisjoint(found.name for found in pkgutil.iter_modules(module.__path__))


def test_public_packages_load_nothing_before_it_is_used() -> None:
    code = "import sys, haptorb, haptorb_study, haptorb_design; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert {"haptorb", "haptorb_study", "haptorb_design"} <= set(loaded)
    assert {"numpy", "numba", "matplotlib", "pydantic", "sqlalchemy"}.isdisjoint(loaded)
