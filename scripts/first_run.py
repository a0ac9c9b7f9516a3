"""How long `make run` takes from a fresh clone to the console's address: python scripts/first_run.py [--write]

What is committed is cloned into a temporary folder and started with an empty home: no caches, no environment of its
own but what pip and npm need to reach their registries. --write puts the seconds into README.md, between its marks.
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
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = ("PATH", "LANG", "SSL_CERT_FILE", "REQUESTS_CA_BUNDLE", "NODE_EXTRA_CA_CERTS")
SETTINGS = (".config/pip", ".npmrc")  # of the registries, in a home
MARKED = re.compile(r"(<!-- first-run -->) \d+ s (<!-- /first-run -->)")


def seconds() -> float:
    """From the command to the line that says where the console is."""
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
        start = time.monotonic()
        making = subprocess.Popen(
            ["make", "run", "ARGS=--port 0"], cwd=clone, env={**here, "HOME": str(home)}, text=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True,
        )  # fmt: skip
        assert making.stderr is not None
        lines = []
        try:
            for line in making.stderr:
                lines.append(line)
                if "http://127.0.0.1" in line:
                    return time.monotonic() - start
            raise SystemExit(f"`make run` ended before the console was up:\n{''.join(lines)}")
        finally:
            os.killpg(making.pid, signal.SIGTERM)  # make and the program that it became
            making.communicate()


def main() -> int:
    """Measure, print, and write if asked to."""
    took = seconds()
    print(f"{took:.0f} s from a fresh clone to the console")
    if "--write" in sys.argv[1:]:
        readme = ROOT / "README.md"
        readme.write_text(MARKED.sub(rf"\1 {took:.0f} s \2", readme.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
