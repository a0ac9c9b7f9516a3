"""A user's world or scene, reloaded whenever its file is saved, with the clients' force added to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from haptorb.worlds.dynamic.remote import Remote
from haptorb.worlds.dynamic.remote_sum import join_remote
from haptorb.worlds.own.world_file import WorldFile
from haptorb.worlds.scene.scene_file import SceneFile
from haptorb.worlds.world import World

__all__ = ["FileWithRemote"]


@final
@dataclass(frozen=True)
class FileWithRemote:
    """The world in `file` plus the force of clients. The loop keeps the force when the file is reloaded."""

    file: WorldFile | SceneFile

    def load(self) -> World:
        """The sum of both. Raises what `file.load` raises."""
        return join_remote(self.file.load(), Remote())
