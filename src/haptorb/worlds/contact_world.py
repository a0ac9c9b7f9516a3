"""A world that says what its contacts do, for those who draw and record them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from haptorb.devices.state import State
from haptorb.numerics.arrays import Array
from haptorb.worlds.world import World

__all__ = ["ContactWorld"]


@dataclass(frozen=True)
class ContactWorld(World):
    """A world that computes its wrench from contacts. Where the kind of device has contacts, they go into the row.

    A kind of device says how many contacts its rows have (`DeviceKind.contacts`); a row leaves out what is beyond.
    """

    @abstractmethod
    def render_contacts(self, state: State) -> tuple[Array, Array]:
        """(6,) the wrench at `state` [N, N·m], and (n, 8) its contacts: deflection [m], place on the touched part from
        its root [m], point (3) [m], force (3) on the object [N]; zero for a contact that is open."""

    def wrench(self, state: State) -> Array:
        """(6,) what the mover should feel at `state` [N, N·m]."""
        return self.render_contacts(state)[0]

    @property
    def wrench_code(self) -> Callable[..., Any]:
        """The code that computes the wrench, for messages about it."""
        return type(self).render_contacts
