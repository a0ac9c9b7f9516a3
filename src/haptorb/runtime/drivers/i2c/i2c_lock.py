"""One program at a time drives one chip: a lock per I²C bus and chip, which ends with the process that holds it."""

from __future__ import annotations

import fcntl
import os
import stat
import sys
from contextlib import suppress
from pathlib import Path
from typing import final

from haptorb.errors import DriverError

__all__ = ["BusLock"]

#: the same for every user of this computer, whose own folder for temporary files may be another
_FOLDERS = (Path("/run/lock"), Path("/tmp"))
_TRIES = 10


@final
class BusLock:
    """Held from the beginning; `bus` is the number of the bus's device file, so that another name is the same bus.

    The kernel holds it for every process that has the `descriptor`: a guardian that still tries to switch off keeps it
    when the program itself has ended. The file that it lies on stays, and says who held it last.

    Raises DriverError that names the holder if there is one, or if no file can be made.
    """

    def __init__(self, bus: int, address: int, name: str, folder: Path | None = None) -> None:
        self._name = name
        places = [one for one in _FOLDERS if one.is_dir()] if folder is None else [folder]
        if not places:
            raise DriverError(f"{name} cannot be locked: neither {_FOLDERS[0]} nor {_FOLDERS[1]} is a folder")
        self._path = places[0] / f"haptorb-i2c-{os.major(bus)}-{os.minor(bus)}-{address:02x}.lock"
        self.descriptor = self._lock()
        self.tell()

    def _lock(self) -> int:
        for _ in range(_TRIES):
            try:
                descriptor = _open_file(self._path)
            except OSError as cause:
                raise DriverError(f"{self._name} cannot be locked: {self._path}: {cause.strerror}") from cause
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # safety: i2c-lock
                with suppress(FileNotFoundError):
                    if os.path.samestat(os.stat(self._path), os.fstat(descriptor)):  # safety: i2c-lock-named
                        return descriptor
            except BlockingIOError as cause:
                holder = _holder(descriptor)
                os.close(descriptor)
                raise DriverError(f"{self._name} is in use by {holder}; end it first") from cause
            os.close(descriptor)  # the file was removed meanwhile
        raise DriverError(f"{self._name} cannot be locked: another program keeps removing {self._path}")

    def tell(self, guardian: int = 0) -> None:
        """Write into the file who holds it: this process, and its `guardian`'s number."""
        text = f"{os.getpid()} {guardian} {Path(sys.argv[0]).name or 'python'}"
        with suppress(OSError):  # another user's file may be read only; the lock holds without it
            os.ftruncate(self.descriptor, 0)
            os.pwrite(self.descriptor, text.encode()[:200], 0)

    def close(self) -> None:
        """Release this process's hold. May be called twice."""
        descriptor, self.descriptor = self.descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)


def _open_file(path: Path) -> int:
    """The file, made if it is not there. Made without O_CREAT where it is: the kernel may refuse that in a folder that
    everybody may write to when the file is another user's."""
    flags = os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    for _ in range(_TRIES):
        try:
            return _regular(os.open(path, os.O_RDWR | flags))
        except PermissionError:
            return _regular(os.open(path, os.O_RDONLY | flags))
        except FileNotFoundError:
            with suppress(FileExistsError):
                descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | flags, 0o666)
                os.fchmod(descriptor, 0o666)  # whatever the umask: other users must be able to lock it
                return descriptor
    raise FileNotFoundError(2, "appears and disappears", str(path))


def _regular(descriptor: int) -> int:
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(22, "is not a regular file")
    return descriptor


def _holder(descriptor: int) -> str:
    """Who holds the lock, in words; what the file says may be anybody's."""
    text = os.pread(descriptor, 200, 0).decode("utf-8", "replace")
    number, _, rest = text.partition(" ")
    guardian, _, program = rest.partition(" ")
    if not (number.isdecimal() and guardian.isdecimal() and len(number) < 9 and len(guardian) < 9):
        return "another program"
    shown = "".join(letter if letter.isprintable() else "?" for letter in program)[:80]
    if _is_alive(int(number)):
        return f"process {number} ({shown}): end it first"
    return (
        f"the guardian (process {guardian}) of the ended process {number} ({shown}) is still trying to switch the "
        "coils off. Check bus and supply"
    )


def _is_alive(number: int) -> bool:
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
