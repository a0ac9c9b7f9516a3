"""Which world files this account has started by name: a list of digests in its state folder.

A recording names the file that its world came from, and that file's digest; but whoever makes the recording makes both.
So a recording alone never runs code. Its file runs again only if this account has started exactly that code from that
place: the file, the world in it, and every module that it imports from its folder, as they are now. These texts are
read once; what was compared is what runs (`WorldFile.load`).
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from haptorb.errors import HaptorbError, InputError
from haptorb.files.own_imports import find_imports
from haptorb.files.state_folder import state_folder
from haptorb.files.text_file import open_regular, read_text
from haptorb.worlds.own.world_file import find_world_file
from haptorb.worlds.world import World

__all__ = ["find_started", "list_path", "note_start"]

_MOST = 4 << 20  #: bytes of the list


def list_path() -> Path:
    """The list of this account: one line for each code, its digest and, for people, its file."""
    return state_folder() / "started-worlds"


def note_start(world: World) -> None:
    """A person has started `world`: if it came from a world file, add it to the list.

    Where the list cannot be written, recordings of the world show its recorded wrench.
    """
    found = find_world_file(world)
    if found is None:
        return
    path, name = found
    with suppress(OSError, HaptorbError):
        digest = _digest(path, name, _read_code(path))
        known = list_path()
        if digest in _read_list(known):
            return
        known.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0)
        descriptor = os.open(known, flags, 0o600)
        try:
            os.write(descriptor, f"{digest} {json.dumps(str(path))}\n".encode())  # one call: nobody writes in between
        finally:
            os.close(descriptor)


def find_started(path: Path, name: str) -> dict[Path, str]:
    """The texts of the file `path` and of what it imports from its folder, if this account has started the world
    `name` of just these by name.

    Raises InputError, with the reason, if it has not.
    """
    code = _read_code(path)
    if _digest(path, name, code) not in _read_list(list_path()):  # safety: recordings-run-no-code
        raise InputError(
            f"its code in {path}, with what that imports from its folder, is not on this account's list of worlds that "
            "were started; what a recording names is not executed"
        )
    return code


def _read_code(path: Path) -> dict[Path, str]:
    text = read_text(path, "world file", InputError)
    return {path: text, **find_imports(path, text)}


def _digest(path: Path, name: str, code: Mapping[Path, str]) -> str:
    """Of the file's place, the world's name, and all texts by their places."""
    texts = {str(file): hashlib.sha256(text.encode()).hexdigest() for file, text in code.items()}
    return hashlib.sha256(json.dumps([str(path), name, texts], sort_keys=True).encode()).hexdigest()


def _read_list(path: Path) -> frozenset[str]:
    """The digests in it; none if somebody else could have written it."""
    try:
        with open_regular(path, "list of started worlds", InputError) as file:
            own = _is_own(os.fstat(file.fileno()))  # safety: own-list-only
            lines = file.read(_MOST).splitlines() if own else []
    except InputError:
        return frozenset()
    return frozenset(line[:64].decode("ascii", "replace") for line in lines)


def _is_own(facts: os.stat_result) -> bool:
    """Whether nobody but this account can have written a file; true where the system does not say."""
    return not hasattr(os, "geteuid") or (facts.st_uid == os.geteuid() and not facts.st_mode & 0o022)
