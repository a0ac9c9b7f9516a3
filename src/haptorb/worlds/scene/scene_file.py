"""A scene in a user's XML file, reloaded whenever it or a file that it includes is saved."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from haptorb.errors import InputError
from haptorb.files.text_file import read_bytes
from haptorb.worlds.scene.scene import Scene
from haptorb.worlds.scene.scene_model import find_scene_file

__all__ = ["SceneFile", "parse_scene_file"]

_MOST = 8 * 1024 * 1024  #: bytes of a scene
_NAMES = 200  #: files that are looked at
_NAMED = re.compile(r'\bfile\s*=\s*"([^"]+)"')


def parse_scene_file(text: str, body: str = "", folder: Path | None = None) -> SceneFile:
    """The file of the scene `text`, supplied or a path; relative to `folder`, else to the working directory.

    Raises UnknownName for anything else.
    """
    return SceneFile(find_scene_file(text, folder), body)


@dataclass(frozen=True)
class SceneFile:
    """The scene in the XML file `path`, whose `body` is held, with `values` for some of its parameters."""

    path: Path
    body: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)

    def load(self) -> Scene:
        """Compile the file and return its world. Raises UnknownName and InputError as `Scene` does."""
        scene = Scene(self.path, self.body)
        return scene.replace(**self.values) if self.values else scene

    @property
    def stamp(self) -> tuple[tuple[int, int, int], ...] | None:
        """Changes when the file or one that it includes is saved: time [ns], size, inode; None without it."""
        try:
            found = [_stamp(self.path)]
            text = read_bytes(self.path, _MOST, "scene", InputError).decode("utf-8", "replace")
        except (OSError, InputError):
            return None
        for name in _NAMED.findall(text)[:_NAMES]:
            try:
                found.append(_stamp(self.path.parent / name))
            except OSError:  # a mesh in the folder of <compiler meshdir>, or missing: then loading reports it
                continue
        return tuple(found)


def _stamp(path: Path) -> tuple[int, int, int]:
    found = path.stat()
    return found.st_mtime_ns, found.st_size, found.st_ino
