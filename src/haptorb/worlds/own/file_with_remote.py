"""A user's own world or scene, loaded again whenever its file is saved, with the clients' force beside it."""

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
    """The world in `file`, and the force that programs command. The loop keeps that when the file is loaded again."""

    file: WorldFile | SceneFile

    def load(self) -> World:
        """The sum of both. Raises what `file.load` raises."""
        return join_remote(self.file.load(), Remote())
