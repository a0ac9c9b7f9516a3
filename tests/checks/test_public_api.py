"""The public API: documents, examples and templates use nothing else, and Python and type checkers see the same."""

from __future__ import annotations

import ast
import inspect
import pkgutil
import re
import subprocess
import sys
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from numpydoc.docscrape import get_doc_object
from numpydoc.validate import Validator, validate
from pydantic import BaseModel

from haptorb_study.export_scripts import make_python_script
from haptorb_study.study_file import study_of
from haptorb_study.template import TEMPLATES, make_study_text

PACKAGES = ("haptorb", "haptorb.worlds", "haptorb.devices", "haptorb.kinds", "haptorb.magnetics", "haptorb.testing",
            "haptorb_study", "haptorb_design")  # fmt: skip
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
    kind = ROOT / "tests" / "rail" / "rail.py"  # which the how-to "Add a device" shows as an example
    found[str(kind.relative_to(ROOT))] = kind.read_text(encoding="utf-8")
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


def test_text_names_only_public_modules() -> None:
    """A reader imports what a page names; a file for those who change haptorb is named by its path."""
    skipped = {"_build", "generated", "gallery", "decisions"}
    pages = [page for page in sorted((ROOT / "docs").rglob("*.md")) if not skipped & set(page.parts)]
    others = {"haptorb.commands"}  # a group of entry points
    faults = []
    for page in [ROOT / "README.md", *pages]:
        if page.name == "earlier-files.md":  # which names earlier modules
            continue
        for name in re.findall(
            r"`(haptorb(?:_study|_design)?(?:\.\w+)+)(?:\(.*?\))?`", page.read_text(encoding="utf-8")
        ):
            package = max((one for one in PACKAGES if f"{name}.".startswith(f"{one}.")), key=len)
            rest = name.removeprefix(package).strip(".").partition(".")[0]
            if name not in others and rest and rest not in import_module(package).__all__:
                faults.append(f"{page.name}: {name}")
    assert faults == []


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
    names = set(module.__all__) | {"lazy_names", "__version__", "EARLIER", "get_earlier", "install_finder"}
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


# --------------------------------------------------------------------------------------------------
# Docstrings of public names, judged by numpydoc's own validator.

#: what the validator may object to, and why
IGNORED = {
    "ES01": "a summary and the parameters often say all",
    "SA01": "the page of a package stands for See Also",
    "EX01": "some names need a device, a database or a process; the how-to guides have these examples",
    "YD01": "asks for Yields of context managers and abstract iterators only when it finds a `yield`",
}


def public_objects() -> dict[str, object]:
    """Public classes and functions by their full names."""
    found = {f"{package}.{name}": getattr(import_module(package), name) for package in PACKAGES
             for name in import_module(package).__all__}  # fmt: skip
    return {name: one for name, one in found.items() if inspect.isroutine(one) or inspect.isclass(one)}


def list_documented_elsewhere(thing: object) -> set[str]:
    """Parameters that a class need not describe: those of its public bases, and those declared with their meaning.

    These are `haptorb.worlds.parameter` of a world, and the keys of a file (pydantic), which the reference lists; and
    Python's own parameters of an enumeration.
    """
    if not inspect.isclass(thing):
        return set()
    if issubclass(thing, Enum | BaseModel):
        return set(inspect.signature(thing).parameters) | set(thing.__init__.__annotations__)
    inherited = {name for base in thing.__mro__[1:] if base in public_objects().values()
                 for name in Validator(get_doc_object(base)).doc_all_parameters}  # fmt: skip
    declared = {one.name for one in fields(thing) if "about" in one.metadata} if is_dataclass(thing) else set()
    return inherited | declared


def list_docstring_faults(name: str, thing: object) -> list[str]:
    """What the validator objects to."""
    faults = [
        f"{code} {text}"
        for code, text in validate(get_doc_object(thing))["errors"]
        if code not in IGNORED and code != "PR01"
    ]
    if inspect.isclass(thing) and issubclass(thing, Enum):
        return faults
    wanted = Validator(get_doc_object(thing))
    missing = set(wanted.signature_parameters) - set(wanted.doc_all_parameters) - list_documented_elsewhere(thing)
    return faults + [f"PR01 parameter {one} is not documented" for one in sorted(missing)]


#: classes that people implement or use from programs: all of their methods have sections
DESCRIBED = {
    "haptorb": "Device Driver ErrorSource Feed HandGrip Replay Sample SampledLoop Servo Simulation State WrenchMap",
    "haptorb.worlds": "ContactWorld GuidancePath Outlet SnapFit Terrain World",
    "haptorb.magnetics": "Coil CylinderMagnet RingMagnet Source",
    "haptorb_design": "Design DesignCandidate ResultsWriter",
}


def methods(package: str) -> dict[str, Any]:
    """Methods of public classes with sections, and those with parameters that must have them.

    A method that overrides one of a public base is described there; `check_…` and internal methods need none.
    """
    found: dict[str, Any] = {}
    classes = {name: one for name, one in public_objects().items() if inspect.isclass(one)}
    for full, thing in classes.items():
        if full.rpartition(".")[0] != package:
            continue
        for base in thing.__mro__:
            if not base.__module__.startswith("haptorb") or (base is not thing and base in classes.values()):
                continue
            for key, member in vars(base).items():
                function = getattr(member, "__func__", member)
                if key.startswith("_") or not inspect.isfunction(function) or f"{full}.{key}" in found:
                    continue
                inherited = any(hasattr(one, key) for one in thing.__mro__[1:] if one in classes.values())
                must = full.rpartition(".")[2] in DESCRIBED.get(package, "").split() and not inherited
                takes = set(inspect.signature(function).parameters) - {"self", "cls"}
                has = "\n----" in (inspect.getdoc(function) or "")
                if has or (must and takes and key not in INTERNAL):
                    found[f"{full}.{key}"] = function
    return found


#: methods with parameters that only haptorb itself calls
INTERNAL = {"check_model", "check_tick_model", "replace_own_world"}


@pytest.mark.parametrize("package", PACKAGES)
def test_public_methods_follow_numpydoc(package: str) -> None:
    found = {name: list_docstring_faults(name, one) for name, one in methods(package).items()}
    assert {name: faults for name, faults in found.items() if faults} == {}
    assert package != "haptorb" or {"haptorb.Driver.read", "haptorb.Servo.hold"} <= set(found)


def bad(first: int, second: float = 0.0) -> float:
    """computes a number

    Parameters
    ----------
    first : int
        number without a unit
    third
        Unknown.
    """
    return first + second


def test_the_validator_finds_a_bad_docstring() -> None:
    found = {fault[:4] for fault in list_docstring_faults(f"{__name__}.bad", bad)}
    assert {"SS02", "SS03", "SS05", "PR01", "PR02", "PR04", "PR08", "PR09", "RT01"} <= found


@pytest.mark.parametrize("package", PACKAGES)
def test_public_docstrings_follow_numpydoc(package: str) -> None:
    found = {name: list_docstring_faults(name, one) for name, one in public_objects().items()
             if name.rpartition(".")[0] == package}  # fmt: skip
    assert found
    assert {name: faults for name, faults in found.items() if faults} == {}


def test_numbers_of_public_names_have_shape_and_unit() -> None:
    """An array has its shape in its type and its unit, or what stands for one, in its text; so has a number."""
    plain = re.compile(r"\[|\bunit\b|rotation|unit vectors|structured array", flags=re.IGNORECASE)
    faults = []
    described = public_objects() | {name: one for package in PACKAGES for name, one in methods(package).items()}
    for name, thing in described.items():
        doc = Validator(get_doc_object(thing)).doc
        for one in (*doc["Parameters"], *doc["Returns"]):
            kind = one.type or one.name
            if re.match(r"array_like|ndarray", kind) and "shape (" not in kind:
                faults.append(f"{name}: {one.name} has no shape")
            if re.match(r"array_like|ndarray(?! of bool)|float", kind) and not plain.search(" ".join(one.desc)):
                faults.append(f"{name}: {one.name} has no unit")
    assert faults == []
