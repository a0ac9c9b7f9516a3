"""The documentation builds without warnings, loads nothing external, and its links work."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from urllib.parse import unquote, urldefrag

import pytest

from oracles.repetitions import LONG

PACKAGES = ("haptorb", "haptorb.worlds", "haptorb.devices", "haptorb.magnetics", "haptorb_study", "haptorb_design")


class Links(HTMLParser):
    """What a page fetches by itself, where it points, and which anchors it has."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.targets: list[str] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.anchors |= {value for key in ("id", "name") if (value := given.get(key))}
        if tag == "a" and given.get("href"):
            self.targets.append(str(given["href"]))
        if tag == "link" and given.get("rel") not in ("canonical", "next", "prev", "index", "search", "genindex"):
            self.fetched.append(str(given.get("href")))
        self.fetched += [str(given[key]) for key in ("src", "srcset", "poster") if given.get(key)]


@pytest.fixture(scope="session")
def built(root: Path) -> Path:
    """The folder of the built pages."""
    output = root / "docs" / "_build" / "html"
    if run := os.environ.get("PYTEST_XDIST_TESTRUNUID"):  # it takes minutes: one process has all tests of this file
        (root / "docs" / "_build").mkdir(exist_ok=True)
        (root / "docs" / "_build" / f"{run}.once").touch(exist_ok=False)
    # The examples run in tests/test_examples.py, all docstrings are parsed in test_docstrings.py.
    # The theme's navigation, which is the same on every page, takes a quarter of the time: it is built at night.
    theme = [] if LONG else ["-D", "html_theme=basic"]
    build(root, output, "-D", "plot_gallery=0", "-D", "rooms_in_brief=1", *theme)
    return output


def build(root: Path, output: Path, *options: str) -> None:
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "docs", str(output), *options]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.fail(f"the documentation does not build:\n{done.stdout}{done.stderr}", pytrace=False)


@pytest.fixture(scope="session")
def links(built: Path) -> dict[Path, Links]:
    """Every built page, parsed."""
    parsed = {}
    for page in sorted(built.rglob("*.html")):
        parsed[page] = Links()
        parsed[page].feed(page.read_text(encoding="utf-8"))
    return parsed


@pytest.mark.timeout(900)
def test_reading_it_asks_nobody_else_for_anything(built: Path, links: dict[Path, Links]) -> None:
    elsewhere = [
        f"{page.relative_to(built)}: {url}"
        for page, found in links.items()
        for url in found.fetched
        if re.match(r"(https?:)?//", url)
    ]
    for sheet in built.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        elsewhere += [
            f"{sheet.relative_to(built)}: {url}"
            for url in re.findall(r"(?:url\(|@import )['\"]?(https?:[^'\")]+)", text)
        ]
    assert len(links) > 20
    assert elsewhere == []


@pytest.mark.timeout(900)
def test_no_internal_link_is_dead(built: Path, links: dict[Path, Links]) -> None:
    dead = []
    for page, found in links.items():
        for target in found.targets:
            if re.match(r"[a-z]+:", target) or target == "#":
                continue
            file, anchor = urldefrag(target)
            goal = (page.parent / unquote(file)).resolve() if file else page
            if not goal.exists():
                dead.append(f"{page.relative_to(built)} → {target}")
            elif anchor and goal in links and unquote(anchor) not in links[goal].anchors:
                dead.append(f"{page.relative_to(built)} → {target} (no such anchor)")
    assert dead == []


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_every_module_has_its_place_in_the_reference(root: Path, tmp_path: Path) -> None:
    build(root, tmp_path / "html", "-D", "plot_gallery=0")
    assert (
        "haptorb.magnetics.current_sheets.zonal" in (tmp_path / "html/reference/generated/magnetics.html").read_text()
    )


@pytest.mark.timeout(900)
def test_the_public_api_is_one_page_with_every_name(built: Path, links: dict[Path, Links]) -> None:
    folder = built / "reference" / "generated"
    targets = {target for target in links[folder / "api.html"].targets if "#" in target}
    for package in PACKAGES:
        page = f"api-{package.replace('.', '-')}.html"
        for name in import_module(package).__all__:
            assert f"{page}#{package}.{name}" in targets
            assert f"{package}.{name}" in links[folder / page].anchors
