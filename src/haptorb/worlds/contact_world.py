"""A world that reports its contacts, for drawing and recording."""

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
    """A world that computes its wrench from contacts. They are recorded if the kind of device has contacts.

    A kind of device states how many contacts its rows have (`DeviceKind.contacts`); excess contacts are left out.
    """

    @abstractmethod
    def render_contacts(self, state: State) -> tuple[Array, Array]:
        """(6,) the wrench at `state` [N, N·m], and (n, 8) its contacts: deflection [m], distance of the contact
        from the root [m], point (3) [m], force (3) on the object [N]; zero for an open contact."""

    def wrench(self, state: State) -> Array:
        """(6,) the wrench on the mover at `state` [N, N·m]."""
        return self.render_contacts(state)[0]

    @property
    def wrench_code(self) -> Callable[..., Any]:
        """The code that computes the wrench, for messages about it."""
        return type(self).render_contacts
