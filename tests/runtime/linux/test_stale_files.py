"""Files of ended programs are removed at the next start; those of running programs and other users stay."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from haptorb import files
from haptorb.devices.loader import load
from haptorb.files import FileLock, sweep
from haptorb.recording import destination as recording_file
from haptorb.recording.row import RowLayout
from haptorb.runtime.prestart import PrestartedProcess
from haptorb.runtime.servo import Servo
from haptorb.runtime.shared_memory import SharedMemory


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where all that is temporary is made."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(files, "folders", lambda: [tmp_path])
    monkeypatch.setattr("haptorb.runtime.shared_memory.folders", lambda: [tmp_path])
    return tmp_path


_LIVES = """
import sys, time
import tempfile
tempfile.tempdir = sys.argv[1]
from pathlib import Path
from haptorb.runtime import shared_memory
from haptorb.recording import destination as recording_file
from haptorb.recording.row import RowLayout
from haptorb.files import FolderUse, create_private_folder
from typing import get_args
from haptorb.devices.loader import load
shared_memory.folders = lambda: [Path(sys.argv[1])]
memory = shared_memory.SharedMemory.create(RowLayout.of(load("omni")))
held = [create_private_folder(use) for use in get_args(FolderUse)], memory, recording_file.create_temporary()
for made, _ in held[0]:
    (made / "plan").write_text("")
print("made", flush=True)
time.sleep(100)
"""


def test_what_a_killed_program_left_goes_and_nothing_else(folder: Path) -> None:
    kept = [
        folder / name for name in ("haptorb-session1.mcap", "haptorb-servo", "my.shared", "haptorb-a.temporary.txt")
    ]
    for file in kept:
        file.write_text("mine")
    kept += [folder / name for name in ("haptorb-scene-mypicture", "haptorb-page-mine1234", "haptorb-serve-x")]
    for mine in kept[-3:]:
        mine.mkdir(0o755)
    with subprocess.Popen([sys.executable, "-c", _LIVES, str(folder)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"made\n"
        made = set(folder.iterdir()) - set(kept)
        assert len(made) == 2 + len(get_args(files.FolderUse))
        assert sweep() == 0
        assert made <= set(folder.iterdir())
        process.kill()
        process.wait()
    assert sweep() == len(made)
    assert set(folder.iterdir()) == set(kept)


def test_the_own_files_stay_until_they_are_let_go(folder: Path) -> None:
    shared = SharedMemory.create(RowLayout.of(load("omni")))
    path, descriptor, claim = recording_file.create_temporary()
    os.close(descriptor)
    with PrestartedProcess() as standby:
        assert sweep() == 0
        assert standby.folder.is_dir()
    assert shared.path.exists()
    assert path.exists()
    claim.close()
    assert sweep() == 1
    shared.unlink()
    assert list(folder.iterdir()) == []


def test_links_and_what_stands_behind_them_stay(folder: Path) -> None:
    (folder / "precious").write_text("mine")
    (folder / "haptorb-link.shared").symlink_to(folder / "precious")
    assert sweep() == 0
    assert (folder / "precious").read_text() == "mine"


def test_who_was_too_slow_to_claim_a_file_learns_that_it_is_gone(folder: Path) -> None:
    (folder / "haptorb-x.shared").touch()
    descriptor = os.open(folder / "haptorb-x.shared", os.O_RDONLY)
    assert sweep() == 1
    assert not FileLock(folder / "haptorb-x.shared").there
    assert not FileLock(f"/proc/self/fd/{descriptor}").there
    os.close(descriptor)


_CRASHES = """
import sys, tempfile
from pathlib import Path
tempfile.tempdir = sys.argv[1]
from haptorb.runtime import shared_memory
shared_memory.folders = lambda: [Path(sys.argv[1])]
import haptorb
from haptorb.serve.base import Serving, check_servers
servo = haptorb.Servo("omni", "nothing")
with Serving(check_servers(["osc:127.0.0.1:0"]), servo) as serving, servo:
    serving.start()
    print(servo.servo_pid, servo._children.recorder_pid, flush=True)
    servo.run(100)
"""


@pytest.mark.realtime  # a servo ends if its host gets no processor for half a second
def test_the_next_start_removes_what_all_processes_of_a_killed_one_left(folder: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", _CRASHES, str(folder)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        children = [int(pid) for pid in process.stdout.readline().split()]
        for pid in [*children, process.pid]:
            os.kill(pid, signal.SIGSTOP)  # nobody tidies up behind another
        for pid in [*children, process.pid]:
            os.kill(pid, signal.SIGKILL)
        process.wait()
    assert len(list(folder.iterdir())) == 4
    with Servo("omni", "nothing", record=False) as servo:
        assert servo.alive
        assert len(list(folder.iterdir())) == 2  # its own
    assert list(folder.iterdir()) == []
