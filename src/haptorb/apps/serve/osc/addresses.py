"""The OSC addresses that are sent and understood: one table for server and documentation.

Numbers go out as float32, counts and codes as int32, for most OSC programs know no other numbers. Vectors are in the
stator's frame; quaternions are scalar last.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

__all__ = ["INCOMING", "OUTGOING", "REPLIES", "Incoming", "Outgoing"]


@final
@dataclass(frozen=True)
class Outgoing:
    """A message of each bundle: the numbers `first` to `last` of a row's `field`, in `unit`; or the buttons."""

    address: str
    field: str
    values: str  #: names of the values
    unit: str
    about: str
    whole: bool = False  #: whether they are counts or codes, sent as integers
    first: int = 0
    last: int | None = None


@final
@dataclass(frozen=True)
class Incoming:
    """A message that the server understands."""

    address: str
    values: str
    unit: str
    about: str


#: the messages of a bundle, one bundle for a tick
OUTGOING = (
    Outgoing("/haptorb/tick", "tick", "n", "1", "number of the tick, modulo 2³¹", whole=True),
    Outgoing("/haptorb/time", "t", "t", "s", "time of the sample since the start"),
    Outgoing("/haptorb/valid", "valid", "v", "1", "1: the pose is valid, 0: it is not", whole=True),
    Outgoing("/haptorb/position", "p", "x y z", "m", "position of the mover"),
    Outgoing("/haptorb/orientation", "q", "x y z w", "1", "orientation of the mover, quaternion"),
    Outgoing("/haptorb/velocity", "v", "x y z", "m/s", "velocity of the mover"),
    Outgoing("/haptorb/angular_velocity", "w", "x y z", "rad/s", "angular velocity of the mover"),
    Outgoing("/haptorb/force", "modelled", "x y z", "N", "force of the measured currents on the mover", last=3),
    Outgoing("/haptorb/torque", "modelled", "x y z", "N·m", "torque of the measured currents on the mover", first=3),
    Outgoing("/haptorb/force/asked", "asked", "x y z", "N", "force asked by the worlds, after the guard", last=3),
    Outgoing("/haptorb/torque/asked", "asked", "x y z", "N·m", "torque asked by the worlds, after the guard", first=3),
    Outgoing("/haptorb/object/position", "object", "x y z", "m", "position of the object, a motor's target"),
    Outgoing("/haptorb/object/orientation", "object_q", "x y z w", "1", "orientation of the object, quaternion"),
    Outgoing("/haptorb/object/force", "object_wrench", "x y z", "N", "force of the worlds on the object", last=3),
    Outgoing("/haptorb/object/torque", "object_wrench", "x y z", "N·m", "torque of the worlds on the object", first=3),
    Outgoing("/haptorb/buttons", "buttons", "a b c", "1", "1: the button is pressed", whole=True),
    Outgoing("/haptorb/guard", "guard", "n", "1", "0 off, 1 ramping, 2 running, 3 derated, 4 tripped", whole=True),
    Outgoing("/haptorb/trip", "trip", "n", "1", "code of the last trip, 0 for none", whole=True),
)

#: what a program may send
INCOMING = (
    Incoming(
        "/haptorb/subscribe",
        "[port] [rate]",
        "1, Hz",
        "Subscribe: send bundles to this port of the sender (default: its own port), at this rate at most (default: "
        "100). Lasts 10 s; renew it every few seconds.",
    ),
    Incoming("/haptorb/unsubscribe", "[port]", "1", "Unsubscribe."),
    Incoming("/haptorb/parameters", "", "", "Request the world and its parameters."),
    Incoming(
        "/haptorb/parameter/NAME",
        "value ...",
        "as `haptorb worlds WORLD` says",
        "Set the parameter NAME of the current world; one number, or three for a direction.",
    ),
    Incoming("/haptorb/world", "NAME", "", "Change the world, with its default parameters."),
    Incoming(
        "/haptorb/force",
        "x y z",
        "N",
        "Force of the world `remote` on the mover, or on a motor's target. It fades out 50 ms after the last message.",
    ),
)

#: what goes back to the sender of a message, to its own port or to that of its subscription
REPLIES = (
    Incoming("/haptorb/subscribed", "rate", "Hz", "Rate of the bundles."),
    Incoming("/haptorb/world", "NAME", "", "The current world: reply to `/haptorb/parameters` and `/haptorb/world`."),
    Incoming(
        "/haptorb/parameter",
        "NAME value low high unit",
        "as stated",
        "A parameter, its value or values, and its range: reply to `/haptorb/parameters`.",
    ),
    Incoming("/haptorb/error", "text", "", "Why a message was refused. At most ten per second and sender."),
)
