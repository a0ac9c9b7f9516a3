"""Startup data of a servo process: pickled by value, so that it includes worlds and devices of a user's script."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast, final

from haptorb.child_process import pack, unpack
from haptorb.devices.base import Implementation, register_implementations
from haptorb.runtime.config import RunConfig
from haptorb.runtime.trackers.base import Tracker
from haptorb.worlds.base import World

if TYPE_CHECKING:
    from haptorb.runtime.tick import Chain

__all__ = ["Plan", "assemble", "load", "save"]


def assemble(config: RunConfig, tracker: Tracker) -> Chain:
    """As `haptorb.runtime.assembly.assemble`, which loads the compiler: the process that makes the plan needs none."""
    from haptorb.runtime import assembly

    return assembly.assemble(config, tracker)


@final
@dataclass(frozen=True)
class Plan:
    """The description of the run, and the worlds to which the loop may change."""

    config: RunConfig
    own_worlds: Mapping[str, World] = field(default_factory=dict)  #: beside the catalogue's, by name
    implementations: tuple[Implementation, ...] = ()  #: of a kind of device that user code defines
    make_chain: Callable[[RunConfig, Tracker], Chain] = assemble

    @property
    def reloads(self) -> bool:
        """Whether a world may be loaded again while the loop runs."""
        return self.config.world_file is not None

    def assemble(self, tracker: Tracker) -> Chain:
        """Build the chain of the run."""
        return self.make_chain(self.config, tracker)

    def practice(self, tracker: Tracker) -> Chain:
        """Build the same chain on the simulated device, for the warm-up before the start."""
        return self.make_chain(self.config.simulated(), tracker)


def save(plan: Plan, path: Path) -> None:
    """Write `plan` to the file `path`, with the folders of its modules."""
    implementations: Any = plan.implementations
    path.write_bytes(pack((implementations, plan)))


def load(path: Path) -> Plan:
    """Read the plan in the file `path`; only for files that the starting process has just written itself."""
    implementations, plan = unpack(path.read_bytes())
    register_implementations(implementations)
    return cast(Plan, plan)
