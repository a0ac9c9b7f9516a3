"""Announces a user's file on standard error before its code runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from haptorb.terminal import announce_wait, notify

if TYPE_CHECKING:
    from haptorb.worlds.base import World
    from haptorb.worlds.user_world import WorldFile

__all__ = ["announce_code", "start_world_file"]

_announced: set[tuple[Path, str]] = set()


def announce_code(path: Path, name: str) -> None:
    """Print once that the code of the file `path` is executed; `name` is the object taken from it."""
    if (path, name) not in _announced:
        _announced.add((path, name))
        notify(f"Running the code of {path}" + (f" ({name})" if name else ""))


def start_world_file(file: WorldFile) -> World:
    """Load the world in `file`, which the user named: its code is executed, and replays of recordings may do so again.

    Raises what `WorldFile.load` raises.
    """
    from haptorb.worlds.user_world import note_start

    announce_code(file.path, file.name)  # safety: code-is-announced
    with announce_wait(f"World file {file.path} has not finished loading"):
        world = file.load()
    note_start(world)
    return world
