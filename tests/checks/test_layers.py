"""Import contract: an upward import is detected at every layer."""

from __future__ import annotations

import re
import tomllib
from itertools import pairwise
from pathlib import Path

import grimp


def test_an_import_that_goes_up_is_found_at_every_layer(root: Path) -> None:
    """From every layer to the one above it, in a graph of the real imports that has none."""
    settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    written = next(one["layers"] for one in settings["contracts"] if one["type"] == "layers")
    layers = [grimp.Layer(*(name.strip() for name in layer.split("|"))) for layer in written]
    graph = grimp.build_graph(*settings["root_packages"], cache_dir=None)
    assert graph.find_illegal_dependencies_for_layers(layers) == set()
    for above, below in pairwise(layers):
        for upper in sorted(above.module_tails):
            for lower in sorted(below.module_tails):
                graph.add_import(importer=lower, imported=upper)
                found = graph.find_illegal_dependencies_for_layers(layers)
                graph.remove_import(importer=lower, imported=upper)
                assert any(one.importer == lower and one.imported == upper for one in found), f"{lower} → {upper}"
    for layer in layers:
        for one, other in pairwise(sorted(layer.module_tails)):
            graph.add_import(importer=one, imported=other)
            found = graph.find_illegal_dependencies_for_layers(layers)
            graph.remove_import(importer=one, imported=other)
            assert found, f"{one} → {other}"


def test_every_module_of_the_package_has_a_layer(root: Path) -> None:
    settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    written = next(one["layers"] for one in settings["contracts"] if one["type"] == "layers")
    named = {name.strip() for layer in written for name in layer.split("|")}
    files = {path.stem if path.suffix == ".py" else path.name for path in (root / "src" / "haptorb").iterdir()}
    modules = {f"haptorb.{name}" for name in files if not name.startswith("__") and not name.endswith(".typed")}
    assert modules - named == set()


def test_the_decision_shows_every_layer(root: Path) -> None:
    """What the contract names is in the picture of decision 01, where people look for it."""
    settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    written = next(one["layers"] for one in settings["contracts"] if one["type"] == "layers")
    named = {name.strip().removeprefix("haptorb.") for layer in written for name in layer.split("|")}
    decision = (root / "docs" / "decisions" / "01-layers.md").read_text(encoding="utf-8")
    assert named - set(re.findall(r"\w+", decision.split("```")[1])) == set()
