"""Two programs on one chip: the second is refused, with the owner's name, however the first ends."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from haptorb.cli.board_tools import probe
from haptorb.devices.loader import load
from haptorb.errors import DriverError
from haptorb.runtime.drivers import i2c as i2c_chips
from haptorb.runtime.drivers.i2c import BusLock, I2cDriver
from haptorb.runtime.drivers.i2c_guardian import Guardian
from oracles.chips import ChipBus, Thermometers

BUS = os.makedev(89, 1)
NAME = "the PWM chip at 0x60 on i2c:1"


def lock(folder: Path, address: int = 0x60, bus: int = BUS) -> BusLock:
    return BusLock(bus, address, NAME, folder)


def test_the_second_is_told_who_has_it(tmp_path: Path) -> None:
    first = lock(tmp_path)
    program = Path(sys.argv[0]).name
    with pytest.raises(DriverError, match=rf"0x60 on i2c:1 is in use by process {os.getpid()} \({program}\)"):
        lock(tmp_path)
    lock(tmp_path, 0x61).close()
    lock(tmp_path, bus=os.makedev(89, 2)).close()
    first.close()
    first.close()
    lock(tmp_path).close()


@pytest.mark.parametrize("umask", [0o022, 0o077])
def test_another_user_can_use_the_file_that_is_left(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        lock(tmp_path).close()
    finally:
        os.umask(before)
    (file,) = tmp_path.iterdir()
    assert file.stat().st_mode & 0o777 == 0o666


def test_a_program_that_was_killed_holds_nothing(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from haptorb.runtime.drivers.i2c import BusLock; "
        f"BusLock({BUS}, 0x60, 'it', Path(sys.argv[1])); print('held', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(DriverError, match=f"process {other.pid}"):
            lock(tmp_path)
        other.kill()
    lock(tmp_path).close()


def test_a_guardian_that_still_tries_keeps_it(tmp_path: Path) -> None:
    one = lock(tmp_path)
    guardian = Guardian(["sh", "-c", "printf +; exec sleep 60"], (one.descriptor,))
    one.write_holder(guardian.pid)
    assert guardian.wait_until_ready(10.0)
    one.close()
    with pytest.raises(DriverError, match="in use by"):
        lock(tmp_path)
    file = next(tmp_path.iterdir())
    file.write_text(file.read_text().replace(str(os.getpid()), "99999999"))  # as if this program had ended
    with pytest.raises(
        DriverError, match=rf"guardian \(process {guardian.pid}\).* still trying to switch the coils off"
    ):
        lock(tmp_path)
    assert guardian.end(0.0) or guardian.end(10.0)
    lock(tmp_path).close()


@pytest.mark.parametrize("text", ["", "x", "1 2", "12 \N{PILE OF POO} a", "1 0 a\x1b[31mb\nc" + 300 * "d", "\0\0"])
def test_what_the_file_says_is_not_trusted(tmp_path: Path, text: str) -> None:
    one = lock(tmp_path)
    next(tmp_path.iterdir()).write_text(text)
    with pytest.raises(DriverError) as refused:
        lock(tmp_path)
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 250
    one.close()


def remove(path: Path) -> None:
    path.unlink()


def another(path: Path) -> None:
    path.unlink()
    path.write_text("")


@pytest.mark.parametrize("deed", [remove, another])
def test_a_file_that_was_removed_is_no_lock(tmp_path: Path, deed: Callable[[Path], None]) -> None:
    """Who holds what no longer has a name excludes nobody: the next one gets a file of its own, and holds that."""
    first = lock(tmp_path)
    deed(next(tmp_path.iterdir()))
    second = lock(tmp_path)
    with pytest.raises(DriverError, match="in use"):
        lock(tmp_path)
    first.close()
    second.close()


def test_a_file_that_is_removed_before_it_is_locked_is_not_the_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, removals = fcntl.flock, [1]

    def late(descriptor: int, how: int) -> None:
        if removals:
            removals.pop()
            next(tmp_path.iterdir()).unlink()
        real(descriptor, how)

    monkeypatch.setattr("fcntl.flock", late)
    first = lock(tmp_path)
    with pytest.raises(DriverError, match="in use"):
        lock(tmp_path)
    first.close()


def test_a_link_in_its_place_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "haptorb-i2c-89-1-60.lock"
    (tmp_path / "elsewhere").write_text("keep me")
    file.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(DriverError, match="cannot be locked"):
        lock(tmp_path)
    assert (tmp_path / "elsewhere").read_text() == "keep me"
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(DriverError, match="not a regular file"):
        lock(tmp_path)


def test_two_drivers_do_not_share_a_bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first drives, the second is refused by name before it has sent anything."""
    chips, pwm, _, _ = ChipBus.of_device()
    monkeypatch.setattr(i2c_chips, "LinuxBus", lambda number: _BorrowedBus(chips))
    monkeypatch.setattr(i2c_chips, "device_number", lambda number: BUS)
    monkeypatch.setattr(i2c_chips, "BusLock", lambda bus, address, name: BusLock(bus, address, name, tmp_path))
    monkeypatch.setattr(
        i2c_chips,
        "Guardian",
        lambda command, inherited: Guardian(["sh", "-c", "printf +; exec cat"], inherited),
    )
    first, second = (I2cDriver(load("omni"), 1, thermometers=Thermometers, clock=lambda: chips.now) for _ in range(2))
    with first:
        first.write(np.array([0.25, 0.0, 0.0]))
        carried = chips.bytes_carried
        with pytest.raises(DriverError, match=f"in use by process {os.getpid()}"):
            second.open()
        (found,) = probe(ports=[], buses=[1])
        assert not found.answers
        assert f"in use by process {os.getpid()}" in found.about[0]
        assert chips.bytes_carried == carried
        assert pwm.duties()[0] == pytest.approx(0.25, abs=1e-3)
    with second:
        second.write(np.array([0.25, 0.0, 0.0]))


class _BorrowedBus:
    def __init__(self, chips: ChipBus) -> None:
        self.transfer = chips.transfer

    def close(self) -> None:
        return
