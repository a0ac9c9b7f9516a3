"""PostgreSQL server for a test, in a temporary folder."""

from __future__ import annotations

import os
import pwd
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PROGRAMS = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))


def explain_absence() -> str:
    """Why there can be no server here; empty: there can."""
    if not PROGRAMS:
        return "no PostgreSQL on this machine (Debian: postgresql)"
    if os.getuid() == 0 and _user() is None:
        return "PostgreSQL does not run as root, and there is neither a user postgres nor nobody"
    return ""


@contextmanager
def start_postgres() -> Iterator[str]:
    """URL of an empty database that lasts as long as the block. Data are written through, as in earnest."""
    programs, user = PROGRAMS[-1].parent, _user()
    folder = Path(tempfile.mkdtemp(prefix="haptorb-pg-"))
    who = {} if user is None else {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}
    try:
        if user is not None:
            os.chown(folder, user.pw_uid, user.pw_gid)
        environment = {"PATH": os.environ["PATH"], "LC_ALL": "C.UTF-8", "HOME": str(folder)}
        init = [programs / "initdb", "-D", folder / "data", "-U", "study", "-A", "trust", "-E", "UTF8", "--no-sync"]
        _run_checked(init, folder, environment, who)
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        options = f"-c listen_addresses=127.0.0.1 -c port={port} -c unix_socket_directories={folder}"
        control = [programs / "pg_ctl", "-D", folder / "data", "-w", "-t", "60", "-l", folder / "log"]
        _run_checked([*control, "-o", options, "start"], folder, environment, who)
        try:
            yield f"postgresql://study@127.0.0.1:{port}/postgres"
        finally:
            _run_checked([*control, "-m", "immediate", "stop"], folder, environment, who)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _user() -> pwd.struct_passwd | None:
    """Whom root becomes; None where nobody else is needed, or to be had."""
    if os.getuid() != 0:
        return None
    for name in ("postgres", "nobody"):
        try:
            return pwd.getpwnam(name)
        except KeyError:
            continue
    return None


def _run_checked(command: list[object], folder: Path, environment: dict[str, str], who: dict[str, object]) -> None:
    # Not through pipes: the server inherits them, and reading them would last as long as it does.
    with (folder / "said").open("wb") as said:
        ran = subprocess.run(
            [str(part) for part in command], cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=said,
            stderr=said, check=False, timeout=90, **who,
        )  # type: ignore[call-overload]  # fmt: skip
    assert ran.returncode == 0, (folder / "said").read_text()
