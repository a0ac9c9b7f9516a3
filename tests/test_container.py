"""Containers: another user id without a home, a read-only root and 8 MB of /dev/shm."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from haptorb.cache_folder import find_home
from oracles.other_account import needs_root

#: in a mount namespace of its own: Python stays readable, the rest is read-only, and $1 is run as user 12345
SCRATCH = r"""
set -e
python=$2; folder=$3
if [ "${python#/root/}" != "$python" ]; then   # the interpreter lies in root's home
    mkdir -p "$folder/kept"; mount --bind /root "$folder/kept"; mount -t tmpfs -o mode=755 tmpfs /root
    for one in "$folder"/kept/.[a-z]* "$folder"/kept/[a-zA-Z]*; do
        [ -d "$one" ] || continue
        name=$(basename "$one"); mkdir "/root/$name"; mount --bind "$one" "/root/$name"
    done
fi
mount -t tmpfs -o size=8m,mode=1777 tmpfs /dev/shm
mkdir -p "$folder/tmp"; mount -t tmpfs -o mode=1777 tmpfs "$folder/tmp"
mount -o remount,bind,ro /
cd "$folder/tmp"
exec setpriv --reuid 12345 --regid 12345 --clear-groups --inh-caps=-all --bounding-set=-all \
    env -u HOME -u XDG_CACHE_HOME -u XDG_STATE_HOME -u NUMBA_CACHE_DIR -u HAPTORB_CACHE_FOLDER TMPDIR="$folder/tmp" \
    sh -c "$1"
"""


def run_in_scratch(folder: Path, command: str) -> subprocess.CompletedProcess[str]:
    for one in (folder, *folder.parents):  # pytest's folders are its account's alone
        if one.stat().st_uid == os.getuid() and one != Path("/"):
            one.chmod(one.stat().st_mode | 0o055)
    python = str(Path(sys.executable).resolve())
    return subprocess.run(
        ["unshare", "-m", "sh", "-c", SCRATCH, "sh", command, python, str(folder)],
        capture_output=True, text=True, check=False, timeout=280,
    )  # fmt: skip


def is_possible() -> bool:
    if os.geteuid() != 0 or not shutil.which("unshare") or not shutil.which("setpriv"):
        return False
    return subprocess.run(["unshare", "-m", "true"], capture_output=True, check=False).returncode == 0


HAPTORB = f"{sys.executable} -m haptorb"
scratch = pytest.mark.skipif(not is_possible(), reason="only root can make a scratch root, with unshare and setpriv")


@needs_root
@scratch
def test_cache_and_state_lie_in_a_private_folder_and_one_line_says_so(tmp_path: Path) -> None:
    program = (
        "import os; from haptorb.cache_folder import private_folder; from haptorb.files import state_folder; "
        "made = private_folder('kernels'); print(made, oct(made.stat().st_mode), oct(made.parent.stat().st_mode), "
        "state_folder())"
    )
    done = run_in_scratch(tmp_path, f'{sys.executable} -c "{program}"; ls -A')
    folder = tmp_path / "tmp" / "haptorb-12345"
    assert done.stdout.split() == [f"{folder}/kernels", "0o40700", "0o40700", f"{folder}/state", "haptorb-12345"]
    assert done.stderr == (f"haptorb: this account has no home for a cache folder; {folder} is used instead\n")


@needs_root
@scratch
@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        "inspect omni --json",
        "run omni --headless --duration 1 --json",
        "run pmsm --scene peg --headless --duration 1 --json",
        "design sweep small.toml --count 8 --json",
        "study simulate study.toml --db s.db --participants 1",
    ],
)
def test_commands_run_as_another_user_without_a_home(command: str, tmp_path: Path) -> None:
    design = Path(__file__).parents[1] / "examples" / "design" / "omni-core.toml"
    before = f"cp {design} small.toml; {HAPTORB} study new study --like staircase >/dev/null 2>&1;"
    done = run_in_scratch(tmp_path, f"{before} {HAPTORB} {command}")
    assert done.returncode in (0, 1), done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout


#: what is mounted before `haptorb run`; $1 is an empty folder
MEMORY = {
    "tiny": "mount -t tmpfs -o size=64k tmpfs /dev/shm",
    "full": "mount -t tmpfs -o size=8m tmpfs /dev/shm; head -c 9M /dev/zero >/dev/shm/full 2>/dev/null || true",
    "read-only": "mount -t tmpfs -o ro tmpfs /dev/shm",
    "none anywhere": (
        "mount -t tmpfs -o size=64k tmpfs /dev/shm; mount -t tmpfs -o size=256k tmpfs $1; export TMPDIR=$1; cd $1"
    ),
}


@needs_root
@scratch
@pytest.mark.slow
@pytest.mark.parametrize("memory", MEMORY)
def test_a_start_finds_memory_or_says_where_none_is(memory: str, tmp_path: Path) -> None:
    command = f"{MEMORY[memory]}; {HAPTORB} run omni --headless --duration 0.5 --json; "
    command += "code=$?; ls -A /dev/shm | grep haptorb; ls -A $PWD | grep haptorb; exit $code"
    began = time.monotonic()
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", command, "sh", str(tmp_path)],
        cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    if memory == "none anywhere":
        assert done.returncode == 2
        assert re.fullmatch(r"haptorb: no room for \d+ MB in /dev/shm or\s\S+; free some\n", done.stderr)
        assert done.stdout == "", "nothing is left behind"
        assert time.monotonic() - began < 5.0 + 15.0  # its own 5 s, and loading on a busy computer
        return
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["ticks"] > 300


def test_an_account_without_a_home_is_recognised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    assert find_home(".cache") == ""
