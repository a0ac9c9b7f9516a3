"""A prestarted servo process that receives no configuration ends without a trace."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from haptorb import files
from haptorb.cli import main
from haptorb.errors import InputError, ServoError
from haptorb.runtime.prestart import PrestartedProcess
from haptorb.runtime.servo import Servo
from haptorb.worlds import Dome

pytestmark = pytest.mark.realtime(retry=False)


def eventually(true: Callable[[], bool], seconds: float = 20.0) -> bool:
    """Whether it becomes true within `seconds`."""
    end = time.monotonic() + seconds
    while not true():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where temporary folders are made."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


def test_one_that_is_not_needed_leaves_nothing(folders: Path) -> None:
    with PrestartedProcess() as standby:
        assert standby.process.poll() is None
        assert [standby.folder] == list(folders.iterdir())
    assert standby.process.poll() is not None
    assert list(folders.iterdir()) == []


def test_a_servo_takes_the_one_it_is_given_and_tidies_up(folders: Path) -> None:
    servo = Servo("omni", "dome", record=False)
    with PrestartedProcess() as standby:
        servo.open(standby)
        assert servo.servo_pid == standby.process.pid
    assert servo.alive  # the end of the block is no longer its end
    servo.close()
    assert standby.process.poll() == 0
    assert list(folders.iterdir()) == []


def test_it_serves_once(folders: Path) -> None:
    with PrestartedProcess() as standby:
        first = Servo("omni", "dome", record=False)
        first.open(standby)
        try:
            with pytest.raises(ServoError, match="serves another servo"):
                Servo("omni", "dome", record=False).open(standby)
            assert first.alive
        finally:
            first.close()
    assert list(folders.iterdir()) == []


def test_a_plan_that_cannot_be_sent_ends_it(folders: Path) -> None:
    class LockedDome(Dome):
        def __reduce__(self) -> str:
            raise TypeError("not to be pickled")

    servo = Servo("omni", LockedDome(), record=False)
    standby = PrestartedProcess()
    with pytest.raises(InputError, match="cannot be sent to the servo's process: not to be pickled"):
        servo.open(standby)
    assert standby.process.poll() is not None
    assert list(folders.iterdir()) == []


def test_it_may_die_before_it_is_needed(folders: Path) -> None:
    servo = Servo("omni", "dome", record=False)
    with PrestartedProcess() as standby:
        standby.process.kill()
        standby.process.wait()
        with pytest.raises(ServoError, match="the servo ended: its process was killed \\(SIGKILL\\)"):
            servo.open(standby)
    assert list(folders.iterdir()) == []


WAITS = """
import sys, time
from haptorb.runtime.prestart import PrestartedProcess
standby = PrestartedProcess()
print(standby.process.pid, standby.folder, flush=True)
time.sleep(60)
"""


def test_it_ends_with_who_started_it(tmp_path: Path) -> None:
    host = subprocess.Popen(
        [sys.executable, "-c", WAITS], stdout=subprocess.PIPE, text=True, env={**os.environ, "TMPDIR": str(tmp_path)}
    )
    assert host.stdout is not None
    number, folder = host.stdout.readline().split()
    assert Path(folder).parent == tmp_path
    host.kill()
    host.communicate()
    ended = eventually(lambda: not Path(f"/proc/{number}").exists())
    if not ended:  # the next who measures here would wonder who takes the processor
        os.kill(int(number), signal.SIGKILL)
    assert ended
    assert list(tmp_path.iterdir()) == []


def test_a_mistake_on_the_command_line_leaves_nothing(folders: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "omni", "--world", "dme", "--headless", "--duration", "1"]) == 2
    assert "dome" in capsys.readouterr().err
    assert list(folders.iterdir()) == []


def test_a_folder_that_another_start_removed_before_it_was_locked_is_made_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    removed = list[Path]()
    explain = files.explain_shared

    def remove_and_explain(folder: Path) -> str:
        if not removed:
            removed.append(folder)
            folder.rmdir()
        return explain(folder)

    monkeypatch.setattr(files, "explain_shared", remove_and_explain)
    made, lock = files.create_private_folder("servo")
    lock.close()
    assert made.is_dir()
    assert removed
    assert made != removed[0]
