"""Every public name has a docstring; in physics also with units."""

from __future__ import annotations

import inspect
import pkgutil
import runpy
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from io import StringIO
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import haptorb


@cache
def modules() -> list[ModuleType]:
    """All modules of the package that do not begin with an underscore."""
    tops = map(import_module, ("haptorb", "haptorb_bench", "haptorb_design", "haptorb_papers", "haptorb_study"))
    names = [found.name for top in tops for found in pkgutil.walk_packages(top.__path__, f"{top.__name__}.")]
    return [import_module(name) for name in names if not any(part.startswith("_") for part in name.split("."))]


def public(module: ModuleType) -> Iterator[tuple[str, object]]:
    """Names that a module declares and defines itself."""
    for name in getattr(module, "__all__", ()):
        thing = getattr(module, name)
        if getattr(thing, "__module__", None) == module.__name__:
            yield name, thing


def list_silent(module: ModuleType) -> list[str]:
    """What a module offers without a docstring."""
    silent = [] if inspect.getdoc(module) else ["the module itself"]
    for name, thing in public(module):
        if not (inspect.isclass(thing) or inspect.isroutine(thing)):
            continue
        if not thing.__doc__:
            silent.append(name)
        if not inspect.isclass(thing):
            continue
        for key, member in vars(thing).items():
            inner = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
            if key.startswith("_") or not (inspect.isroutine(inner) or isinstance(member, property)):
                continue
            if not inspect.getdoc(getattr(thing, key)):
                silent.append(f"{name}.{key}")
    return [f"{module.__name__}: {name}" for name in silent]


def test_public_names_are_documented() -> None:
    assert len(modules()) > 200
    assert [name for module in modules() for name in list_silent(module)] == []


def docstrings(module: ModuleType) -> Iterator[tuple[str, str]]:
    """(name, text) of what the documentation shows of a module: itself, its public names, their public members."""
    yield module.__name__, inspect.getdoc(module) or ""
    for name, thing in public(module):
        yield f"{module.__name__}.{name}", inspect.getdoc(thing) or ""
        for key in vars(thing) if inspect.isclass(thing) else ():
            if not key.startswith("_"):
                yield f"{module.__name__}.{name}.{key}", inspect.getdoc(getattr(thing, key)) or ""


def find_faults(converted: list[str], settings: Any) -> str:
    """What docutils has to say against a docstring after its conversion by docs/_ext/plain_docstrings.py."""
    from docutils.parsers.rst import Parser
    from docutils.utils import new_document

    settings.warning_stream = said = StringIO()
    Parser().parse("\n".join(converted), new_document("docstring", settings))
    return said.getvalue()


@pytest.mark.slow
def test_every_docstring_is_parsed_without_a_warning(root: Path) -> None:
    """As the whole documentation's build does in the nightly run, which needs a minute for it."""
    docutils = pytest.importorskip("docutils.frontend")
    settings = docutils.get_default_settings(import_module("docutils.parsers.rst").Parser)
    convert = runpy.run_path(str(root / "docs" / "_ext" / "plain_docstrings.py"))["converted"]
    assert "Unexpected indentation" in find_faults(["one", "two", "   three"], settings)
    assert "Unexpected indentation" not in find_faults(convert(["one", "two", "   three"]), settings)
    faults = [f"{name}: {said}" for one in modules() for name, text in docstrings(one)
              if (said := find_faults(convert(text.splitlines()), settings))]  # fmt: skip
    assert faults == []


def test_declared_names_exist() -> None:
    absent = [
        f"{module.__name__}: {name}"
        for module in modules()
        for name in getattr(module, "__all__", ())
        if not hasattr(module, name)
    ]
    assert absent == []


def test_what_the_package_offers_exists() -> None:
    assert all(getattr(haptorb, name) is not None for name in haptorb.__all__)


def test_physics_names_its_units() -> None:
    """A function that returns numbers says in brackets what they are measured in, or that they are plain: [1]."""
    mute = []
    for module in modules():
        if not module.__name__.startswith(("haptorb.magnetics.", "haptorb.thermal", "haptorb.beams")):
            continue
        for name, thing in public(module):
            if not inspect.isfunction(thing) or "Array" not in str(inspect.signature(thing).return_annotation):
                continue
            if "[" not in (thing.__doc__ or "") and "(" not in (thing.__doc__ or ""):
                mute.append(f"{module.__name__}: {name}")
    assert mute == []
