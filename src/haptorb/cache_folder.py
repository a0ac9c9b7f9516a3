"""Cache folder of this account, which no other account may write to: compiled kernels in it are executed.

numba and pint store pickles there. Whoever can write such a file can execute code in the next program that loads it.
A folder that belongs to another account, or that others can write to, directly or through a parent folder, is refused
with one line, and a private one is used instead.
"""

from __future__ import annotations

import atexit
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

__all__ = ["cache_folder", "can_write_to", "explain_shared", "find_base", "find_home", "private_folder"]

_CHOSEN = "HAPTORB_CACHE_FOLDER"  #: tells child processes the choice, for one message only


def cache_folder() -> Path:
    """Return the folder for data that can be recomputed: $XDG_CACHE_HOME/haptorb, else ~/.cache/haptorb.

    Another private folder if that one is shared with other accounts or cannot be created, such as in a container
    without a writable home; this is reported once on standard error. Without such a home
    Matplotlib's files lie there, too.
    """
    return _choose(find_base("XDG_CACHE_HOME", ".cache"))


def find_base(variable: str, *parts: str) -> str:
    """Return the base folder in the environment `variable`, such as XDG_CACHE_HOME, else `parts` below the home.

    A relative path in it is ignored, as the XDG Base Directory Specification asks for: it would be another folder for
    each working directory. Empty if this account has no home either.
    """
    stated = os.environ.get(variable, "")
    return stated if os.path.isabs(stated) else find_home(*parts)


def can_write_to(folder: Path) -> bool:
    """Whether this account can write to `folder`, or create it: a home may be /dev/null, which can be written, too."""
    there = next((one for one in (folder, *folder.parents) if one.exists()), folder)
    return there.is_dir() and os.access(there, os.W_OK)


def find_home(*parts: str) -> str:
    """Return `parts` below this account's home; empty if it has none, as is possible for an account without a name."""
    home = os.path.expanduser("~")
    none = not os.path.isabs(home) or os.environ.get("HOME") == ""  # an empty one would mean the root folder
    return "" if none else os.path.join(home, *parts)


def private_folder(*parts: str) -> Path:
    """Return the folder `parts` below `cache_folder`, created if it is missing.

    Raises OSError if it cannot be created, or if others can write there.
    """
    folder = cache_folder()
    for part in parts:
        folder = folder / part
        _make(folder)
    shared = explain_shared(folder)
    if shared:  # safety: cache-own
        raise PermissionError(f"{folder} {shared}")
    return folder


def explain_shared(folder: Path) -> str:
    """Explain why others could put files into `folder`; "" if only this account can.

    All parent folders are checked up to the root: whoever can rename one can substitute another. In a sticky folder,
    such as /tmp, only the owner can.
    """
    if not hasattr(os, "getuid"):
        return ""  # Windows: the profile's folders are the user's own
    places = [folder.absolute(), folder.resolve()]  # symbolic links on the path, and their targets
    for place in dict.fromkeys(one for path in places for one in (path, *path.parents)):
        try:
            why = _explain_one(place, last=place in places)
        except OSError as cause:
            return f"cannot be looked at ({cause.strerror})"
        if why:
            return why if place in places else f"lies in {place}, which {why}"
    return ""


def _explain_one(place: Path, *, last: bool) -> str:
    if not hasattr(os, "getuid"):
        return ""
    found = place.lstat()
    own = found.st_uid == os.getuid()
    if not own and (found.st_uid != 0 or (last and not stat.S_ISLNK(found.st_mode))):
        return f"belongs to another account (user id {found.st_uid})"
    if stat.S_ISLNK(found.st_mode):  # its mode has no meaning
        return ""
    sticky = bool(found.st_mode & stat.S_ISVTX) and not last
    if found.st_mode & stat.S_IWOTH and not sticky:
        return "can be written by every account"
    if found.st_mode & stat.S_IWGRP and not sticky and not _is_own_group(found.st_gid):
        return f"can be written by group {found.st_gid}"
    return ""


def _explain_content(folder: Path) -> str:
    for entry in folder.iterdir():
        why = _explain_one(entry, last=True) if entry.is_dir() else ""
        if why:
            return f"has a folder '{entry.name}' that {why}"
    return ""


@cache
def _is_own_group(group: int) -> bool:
    """Whether this account is the only member of `group`: with private groups, folders are often group-writable."""
    import grp
    import pwd

    try:
        found, user = grp.getgrgid(group), pwd.getpwuid(os.getuid())
    except KeyError:
        return False
    return group == user.pw_gid and found.gr_name == user.pw_name and set(found.gr_mem) <= {user.pw_name}


@cache
def _choose(home: str) -> Path:
    number = os.getuid() if hasattr(os, "getuid") else 0
    wanted = Path(home, "haptorb") if home else None
    chosen_for, chosen = os.environ.get(_CHOSEN, "").partition(os.pathsep)[::2]

    def list_candidates() -> Iterator[Path]:
        if wanted:
            yield wanted
        if chosen_for == home and chosen:
            yield Path(chosen)
            return
        if home:
            yield Path(home, f"haptorb-{number}")
        yield Path(tempfile.gettempdir(), f"haptorb-{number}")  # which raises where there is none

    refused = "" if home else "this account has no home for a cache folder"
    for folder in list_candidates():
        try:
            _make(folder)
            shared = explain_shared(folder) or _explain_content(folder)
        except OSError as cause:  # such as a read-only home
            refused = refused or f"cache folder {folder} cannot be made: {cause.strerror}"
            continue
        if not shared:  # safety: cache-private
            break
        refused = refused or f"cache folder {folder} is not used: it {shared}"
    else:
        folder = Path(tempfile.mkdtemp(prefix="haptorb-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    if folder != wanted and not (chosen_for == home and chosen):
        os.environ[_CHOSEN] = f"{home}{os.pathsep}{folder}"
        if refused:
            print(f"haptorb: {refused}; {folder} is used instead", file=sys.stderr)
    settings = find_base("XDG_CONFIG_HOME", ".config")
    if "MPLCONFIGDIR" not in os.environ and not (settings and can_write_to(Path(settings, "matplotlib"))):
        with suppress(OSError):  # otherwise Matplotlib prints two lines, and looks for fonts each time
            _make(folder / "matplotlib")
            os.environ["MPLCONFIGDIR"] = str(folder / "matplotlib")
    return folder


def _make(folder: Path) -> None:
    """Create the folder for this account only; its parents with default permissions."""
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
