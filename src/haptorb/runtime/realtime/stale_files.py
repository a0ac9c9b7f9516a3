"""Files that a program keeps only while it runs, and how the next one finds those whose owner has ended.

An owner holds a lock on its file (`flock`), which the kernel takes away when the owner ends, however it ends. A file of
ours that can be locked has no owner, and goes.
"""

from __future__ import annotations

import os
import re
import shutil
import stat
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import final

__all__ = ["FOLDER", "RECORDING", "SHARED", "FileLock", "folders", "sweep"]

FOLDER = "haptorb-servo-"  #: beginning of a folder's name
SHARED = ".shared"  #: end of a shared memory's name; it begins with haptorb-
RECORDING = ".temporary.mcap"  #: end of a temporary recording's name; it begins with haptorb-

_OURS = re.compile(rf"haptorb-\w+(?:{re.escape(SHARED)}|{re.escape(RECORDING)})|{FOLDER}\w+", re.ASCII)


@final
class FileLock:
    """Holds the file or folder at `path`, which was just made, until `close` or the end of this process.

    `there` says whether the file still exists: between its creation and this, another program's `sweep` may have
    removed it.
    """

    def __init__(self, path: Path | str) -> None:
        self.there = False
        self._descriptor = -1
        import fcntl  # not at the top: Windows has none, and only a servo needs it

        with suppress(FileNotFoundError):
            self._descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            with suppress(OSError):  # a file system without locks: then `sweep` cannot lock it either, and lets it be
                fcntl.flock(self._descriptor, fcntl.LOCK_EX)
            self.there = os.fstat(self._descriptor).st_nlink > 0

    def close(self) -> None:
        """Release it. May be called twice."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)

    def __del__(self) -> None:
        self.close()


def folders() -> list[Path]:
    """Where such files are made: in memory, where the system has a place for that, and for what is temporary."""
    return [Path("/dev/shm"), Path(tempfile.gettempdir())]


def sweep() -> int:
    """Remove what ended owners of this user left; returns how many files and folders that were.

    Nothing whose owner still runs is touched, nor anything that this package did not name.
    """
    removed = 0
    for folder in dict.fromkeys(folders()):
        with suppress(OSError), os.scandir(folder) as entries:
            for entry in entries:
                if _OURS.fullmatch(entry.name):
                    removed += _remove_if_stale(entry)  # safety: leftovers-swept
    return removed


def _remove_if_stale(entry: os.DirEntry[str]) -> bool:
    """Whether `entry` had no owner; then it is gone."""
    import fcntl

    try:
        found = entry.stat(follow_symlinks=False)
        if found.st_uid != os.geteuid() or not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
            return False
        descriptor = os.open(entry.path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # safety: living-files
        # While the lock is held: a program that creates such a file waits for it, and sees that the file is gone.
        if stat.S_ISDIR(found.st_mode):
            shutil.rmtree(entry.path)
        else:
            os.unlink(entry.path)
    except OSError:  # another user's, or gone already
        return False
    finally:
        os.close(descriptor)
    return True
