"""The plan of a servo process: pickled by value, so that it includes worlds and devices defined in a user's script."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast, final

from haptorb.cluster import pack, unpack
from haptorb.devices.base import Implementation, register_implementations
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig
from haptorb.runtime.tick import Chain
from haptorb.runtime.trackers.base import Tracker
from haptorb.worlds.base import World

__all__ = ["Plan", "load", "save"]


@final
@dataclass(frozen=True)
class Plan:
    """The description of the run, and what the loop may change to."""

    config: RunConfig
    own_worlds: Mapping[str, World] = field(default_factory=dict)  #: beside the catalogue's, by name
    implementations: tuple[Implementation, ...] = ()  #: of a kind of device that a user's code defines
    make_chain: Callable[[RunConfig, Tracker], Chain] = assemble

    @property
    def reloads(self) -> bool:
        """Whether a world may be loaded again while the loop runs."""
        return self.config.world_file is not None

    def assemble(self, tracker: Tracker) -> Chain:
        """The chain of the run."""
        return self.make_chain(self.config, tracker)

    def practice(self, tracker: Tracker) -> Chain:
        """The same chain on the simulated device, which runs before the start."""
        return self.make_chain(self.config.simulated(), tracker)


def save(plan: Plan, path: Path) -> None:
    """Write `plan` to the file `path`, with the folders in which its modules were found."""
    implementations: Any = plan.implementations
    path.write_bytes(pack((implementations, plan)))


def load(path: Path) -> Plan:
    """The plan in the file `path`; only for files that the starting process has just written itself."""
    implementations, plan = unpack(path.read_bytes())
    register_implementations(implementations)
    return cast(Plan, plan)
