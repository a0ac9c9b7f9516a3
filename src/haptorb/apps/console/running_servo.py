"""What the console needs of a servo, and nothing else of it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Protocol

from numpy.typing import ArrayLike

from haptorb.devices.device import Device
from haptorb.numerics.arrays import Array
from haptorb.runtime.row import RowLayout
from haptorb.worlds.world import World

__all__ = ["DescribedServo", "RunningServo"]


class DescribedServo(Protocol):
    """A servo, running or recorded, as the page must know it before the first frame."""

    @property
    def device(self) -> Device:
        """The device that runs."""
        ...

    @property
    def layout(self) -> RowLayout:
        """Which numbers of a row are what."""
        ...

    @property
    def modes(self) -> tuple[str, ...]:
        """How the mover can move a target; empty where the world acts on the mover itself."""
        ...

    @property
    def models(self) -> tuple[str, ...]:
        """The models of the device that its controller can invert, the default first."""
        ...

    @property
    def part_remarks(self) -> tuple[str, ...]:
        """What to say of each part that can be rendered, by its number in the row; empty where there is no choice."""
        ...

    @property
    def driver(self) -> str:
        """ "sim" for the simulated one."""
        ...

    @property
    def tracker(self) -> str:
        """Who knows where the mover is, as in `--tracker`."""
        ...


class RunningServo(DescribedServo, Protocol):
    """A running servo as the console sees it."""

    @property
    def model(self) -> str:
        """The one that it inverts now."""
        ...

    @property
    def world(self) -> tuple[str, Mapping[str, Any]]:
        """Name and values of what is felt now."""
        ...

    @property
    def own_worlds(self) -> Mapping[str, World]:
        """Worlds beside the catalogue's that `set_world` knows, by name; another mapping after one was reloaded."""
        ...

    @property
    def world_trouble(self) -> str:
        """What is wrong with the world's code, and where; empty while all is well. Part of `warning`."""
        ...

    @property
    def render(self) -> str | None:
        """Part of the wrench to render, overriding the world; None: the world's."""
        ...

    @property
    def tracker_refusals(self) -> Mapping[str, int]:
        """How many messages of the tracker's senders were refused so far, by reason."""
        ...

    @property
    def missing_pose(self) -> str:
        """Which pose of a tracker is waited for, with what came instead; empty while poses are valid."""
        ...

    @property
    def recording_trouble(self) -> str:
        """Why there is no recording any more, or none for the moment; empty while all is well."""
        ...

    @property
    def warning(self) -> str:
        """What a person should know of the device or of the servo's memory; empty if there is nothing."""
        ...

    @property
    def connections(self) -> list[dict[str, Any]]:
        """What each server says of the programs that are connected to it; empty without servers."""
        ...

    def press(self, buttons: Collection[str]) -> None:
        """A person holds down these buttons, of a, b, c, and no others; UnknownName for another."""
        ...

    @property
    def alive(self) -> bool:
        """Whether the loop runs."""
        ...

    def rows(self, cursor: int = 0) -> tuple[int, Array]:
        """All rows (n, width) since `cursor`, and the cursor after them."""
        ...

    def point(self, p: ArrayLike, q: ArrayLike | None = None, *, patience: float = 0.0) -> None:
        """The hand wants the mover at `p`; worth nothing after the device's expiry, and `patience` [s] longer where
        the hand is simulated."""
        ...

    def release(self) -> None:
        """The hand releases the pointer."""
        ...

    def stop(self) -> None:
        """Coils off within a tick, and off until `engage`."""
        ...

    def end_loop(self) -> None:
        """Coils off and the loop ended within a tick; returns at once."""
        ...

    @property
    def stops(self) -> int:
        """How often `stop` was called."""
        ...

    def engage(self, stops: int | None = None) -> None:
        """After a stop or a trip: begin again from zero, unless the guard refuses, or `stops` has changed since."""
        ...

    def cool(self) -> None:
        """Simulated coils at the ambient temperature, at once; InputError for a real device."""
        ...

    def set_mode(self, mode: str) -> None:
        """Go over to `mode` without a step; UnknownName for one that there is not."""
        ...

    def set_model(self, name: str) -> None:
        """Invert the device's model `name`, without a step of the force."""

    def clutch(self, engaged: bool) -> None:
        """Let the target go, or take hold of it again; InputError where there is no clutch."""
        ...

    def set_world(self, name: str, values: Mapping[str, Any] | None = None) -> None:
        """Returns when the servo took it, or refused it with UnknownName or InputError."""
        ...
