"""Time of `make run` from a fresh clone to the console's address: python scripts/first_run.py [--write]

The committed files are cloned into a temporary folder and started with an empty home: without caches, and without
settings except those with which pip and npm reach their registries. Printed: the whole time, haptorb's own share
(from the end of the installation: load, compile, start), and the lines printed before the address. It fails if one
exceeds its limit. --write puts the seconds into README.md, between its marks.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = ("PATH", "LANG", "SSL_CERT_FILE", "REQUESTS_CA_BUNDLE", "NODE_EXTRA_CA_CERTS")
SETTINGS = (".config/pip", ".npmrc")  # of the registries, in a home
MARKED = re.compile(r"(<!-- first-run -->) \d+ s (<!-- /first-run -->)")


LONGEST = 45.0  #: from the command to the address [s]
LONGEST_OWN = 20.0  #: of which haptorb's own share [s]
MOST_LINES = 5  #: printed before the address


@dataclass(frozen=True)
class FirstRun:
    """What a newcomer waits for and reads."""

    whole: float  #: from `make run` to the console's address [s]
    own: float  #: from the end of the installation to the address [s]
    lines: list[str]  #: printed before the address

    def print(self) -> None:
        """The figures, one a line."""
        print(f"{self.whole:.0f} s from a fresh clone to the console (limit {LONGEST:.0f} s)")
        print(f"{self.own:.1f} s of which is haptorb's own share (limit {LONGEST_OWN:.0f} s)")
        print(f"{len(self.lines)} lines before the address (limit {MOST_LINES}):")
        print(*(f"    {line}" for line in self.lines), sep="\n")

    def is_within_limits(self) -> bool:
        """Whether all three keep their limits."""
        return self.whole <= LONGEST and self.own <= LONGEST_OWN and len(self.lines) <= MOST_LINES


def measure() -> FirstRun:
    """Clone, `make run`, and read what it prints until it prints where the console is."""
    with tempfile.TemporaryDirectory() as folder:
        clone, home = Path(folder, "clone"), Path(folder, "home")
        home.mkdir()
        for name in SETTINGS:
            if (mine := Path.home() / name).is_dir():
                shutil.copytree(mine, home / name)
            elif mine.exists():
                shutil.copy(mine, home / name)
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
        here = {
            k: v
            for k, v in os.environ.items()
            if k in ENVIRONMENT or k.startswith("PIP_") or k.lower().endswith("_proxy")
        }
        start = time.time()
        making = subprocess.Popen(
            ["make", "run", "ARGS=--port 0"], cwd=clone, env={**here, "HOME": str(home)}, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        assert making.stdout is not None
        lines: list[str] = []
        try:
            for line in making.stdout:
                if "http://127.0.0.1" in line:
                    end = time.time()
                    return FirstRun(end - start, end - (clone / ".venv" / ".run").stat().st_mtime, lines)
                lines.append(line.rstrip())
            raise SystemExit("\n".join(["`make run` ended before the console was up:", *lines]))
        finally:
            os.killpg(making.pid, signal.SIGTERM)  # make and the program that it became
            making.communicate()


def main() -> int:
    """Measure, print, and write if asked to."""
    first = measure()
    first.print()
    if "--write" in sys.argv[1:]:
        readme = ROOT / "README.md"
        text = MARKED.sub(rf"\1 {first.whole:.0f} s \2", readme.read_text(encoding="utf-8"))
        readme.write_text(text, encoding="utf-8")
    return 0 if first.is_within_limits() else 1


if __name__ == "__main__":
    sys.exit(main())
