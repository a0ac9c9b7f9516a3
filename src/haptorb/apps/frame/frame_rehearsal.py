"""A rehearsal of registering a frame: a made-up tracker that speaks OSC, and a simulated person under it."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic, sleep

import numpy as np

from haptorb.apps.frame.frame_steps import Stroke
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.errors import InputError
from haptorb.runtime.trackers.osc_feed import POSE
from haptorb.sensing.frame.frame_registration import FrameRegistration
from haptorb.sensing.frame.touches import Touches
from haptorb.simulation.synthetic_tracker import SimulatedPerson, SyntheticTracker

__all__ = ["PACE", "Rehearsal", "measure_miss", "rehearsal_port"]

PACE = 0.08  #: of a simulated person, who understands at once
_RATE = 200.0  #: poses per second


def rehearsal_port(tracker: str) -> int:
    """The UDP port of `tracker`; InputError if a simulated person cannot speak to it."""
    kind, _, where = tracker.partition(":")
    host, _, port = where.rpartition(":")
    if kind != "osc" or host not in ("", "127.0.0.1", "localhost"):
        raise InputError(f"a rehearsal speaks OSC on this computer: --tracker osc:PORT; got '{tracker}'")
    return int(port)


class Rehearsal:
    """A person under a made-up tracker, drawn by `seed`, who sends to the UDP `port` of this computer."""

    def __init__(self, device: SphericalElectromagnet, port: int, seed: int = 0) -> None:
        self.tracker = SyntheticTracker.draw(seed)
        self._person = SimulatedPerson(device, self.tracker, seed)
        self._port = port
        self._own_port = 0  # of the first stroke's socket, and of all later ones: a tracker accepts one sender

    @contextmanager
    def send_stroke(self, stroke: Stroke) -> Iterator[None]:
        """The stroke, sent by a thread of its own, in its time."""
        over = threading.Event()
        n = max(int(_RATE * stroke.seconds), 40)
        if stroke.name == "dome":
            poses = self._person.dome(n)
        elif stroke.name == "roll":
            poses = self._person.roll(n)
        else:
            poses = self._person.mark(stroke.name.partition(" ")[2], n)
        thread = threading.Thread(target=self._send, args=(poses, stroke.seconds, over), daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()

    def _send(self, poses: Touches, seconds: float, over: threading.Event) -> None:
        from pythonosc.osc_message_builder import OscMessageBuilder

        began = monotonic()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
            one.bind(("127.0.0.1", self._own_port))
            self._own_port = one.getsockname()[1]
            for k, numbers in enumerate(np.column_stack([poses.p, poses.q]).tolist()):
                if over.is_set():
                    return
                sleep(max(began + 0.95 * seconds * k / len(poses) - monotonic(), 0.0))
                message = OscMessageBuilder(POSE)
                for number in numbers:
                    message.add_arg(number, "d")
                one.sendto(message.build().dgram, ("127.0.0.1", self._port))


def measure_miss(
    found: FrameRegistration, tracker: SyntheticTracker, device: SphericalElectromagnet, n: int = 200
) -> tuple[float, float]:
    """(rms [m], greatest angle [rad]) by which the magnet and its axis are missed over the dome, without noise."""
    still = SyntheticTracker(tracker.R, tracker.t, tracker.tip, tracker.axis, 0.0, 0.0)
    person, up = SimulatedPerson(device, still, 1).dome(n), device.tool.tip_distance
    places = person.point(tracker.tip + up * tracker.axis) @ tracker.R.T + tracker.t
    tip = person.point(found.tip + up * found.axis) @ found.R.T + found.t
    axes, axis = tracker.R @ person.R @ tracker.axis, found.R @ person.R @ found.axis
    off = float(np.sqrt(((places - tip) ** 2).sum(axis=1).mean()))
    return off, float(np.arcsin(np.clip(np.linalg.norm(np.cross(axes, axis), axis=1).max(), 0.0, 1.0)))
