"""A world whose code is compiled after the start: selectable, without a trip, and reported meanwhile."""

from __future__ import annotations

import threading
from pathlib import Path
from time import monotonic, sleep

import pytest

from haptorb.cache_folder import cache_folder
from haptorb.errors import InputError
from haptorb.runtime.servo import Servo

pytestmark = [pytest.mark.realtime]

COLD = "worlds.guidance"


@pytest.fixture
def cold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache that has everything but the kernels of one world."""
    with Servo("omni", record=False):  # the dome's code is there now
        pass
    kernels = tmp_path / "haptorb" / "kernels"
    kernels.mkdir(parents=True)
    for folder in (cache_folder() / "kernels").iterdir():
        if folder.name != COLD:
            (kernels / folder.name).symlink_to(folder)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return kernels / COLD


@pytest.mark.slow
def test_a_world_is_chosen_before_its_code_is_there(cold: Path) -> None:
    with Servo("omni", "dome", record=False) as servo:
        assert not list(cold.rglob("*.nbi"))
        chosen = threading.Thread(target=servo.set_world, args=("guidance",))
        chosen.start()
        said, end = "", monotonic() + 60.0
        while chosen.is_alive() and monotonic() < end:
            said = said or servo.warning
            assert servo.world[0] in ("dome", "guidance")  # the world before it goes on
            sleep(0.01)
        chosen.join(1.0)
        assert "guidance" in said
        assert servo.warning == ""
        assert servo.world[0] == "guidance"
        assert list(cold.rglob("*.nbi"))
        servo.set_world("dome")
        servo.set_world("guidance")  # at once, from now on
        servo.run(0.1)
        assert not servo.trips


@pytest.mark.slow
def test_a_value_that_cannot_be_is_refused_as_ever(cold: Path) -> None:
    with Servo("omni", "dome", record=False) as servo:
        with pytest.raises(InputError, match="strength"):
            servo.set_world("guidance", {"strength": "much"})
        assert servo.world[0] == "dome"
        servo.stop()
        assert servo.alive
