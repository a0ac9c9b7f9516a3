"""Strokes that register a tracker's frame: dome, every mark, and a roll; recorded one by one, evaluated together.

The coils stay off. It takes a minute and a half, so a failed step restarts all of them.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from time import monotonic, sleep

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.api import electromagnet
from haptorb.devices.base import Device
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.errors import CalibrationError, DriverError, InputError
from haptorb.estimation.frame_registration import FrameRegistration, Touches, TouchSession, frame_registration
from haptorb.runtime.trackers.base import Feed, RawPose, RejectedPose
from haptorb.runtime.trackers.osc_feed import POSE
from haptorb.simulation.synthetic_tracker import SimulatedPerson, SyntheticTracker

__all__ = [
    "TIME_SCALE",
    "Rehearsal",
    "Stroke",
    "check_device",
    "measure_miss",
    "register_frame",
    "rehearsal_port",
    "strokes",
]


Bar = Callable[[str, float], AbstractContextManager[Callable[[float], None]]]

_MIN_MOTION_M, _MIN_TURN_RAD = 1e-3, np.deg2rad(1.5)  #: least motion since the last stored pose [m], [rad]
_MAX_POSES = 4000  #: poses stored for a step, at most
_POLL_TIMEOUT_S = 0.05  #: timeout of one read
_SILENCE_TIMEOUT_S = 3.0  #: without a pose for this long, the tracker counts as absent [s]
_MAX_DISCARDED_READS = 200  #: reads that discard queued poses, at most: protects against a flood


@dataclass(frozen=True)
class Stroke:
    """One motion with the tool while the tracker is recorded."""

    name: str
    instruction: str  #: instruction to the person before it begins
    seconds: float  #: recording time

    def scale_time(self, pace: float) -> Stroke:
        """Return the stroke with its duration multiplied by `pace`."""
        return Stroke(self.name, self.instruction, pace * self.seconds)


def check_device(device: Device) -> SphericalElectromagnet:
    """Return `device` as an electromagnet; InputError if no frame can be registered on it."""
    known = electromagnet(device, "`haptorb frame`")
    if known.marks is None:
        raise InputError(
            f"device '{known.name}': its file has no [marks]; measure three points that can hold the tip, and add "
            "them as in omni.toml"
        )
    return known


def strokes(device: SphericalElectromagnet) -> tuple[Stroke, ...]:
    """Return the strokes in order: "dome", "mark NAME" for each mark, "roll"."""
    marks = () if device.marks is None else device.marks.names
    stands = [
        Stroke(f"mark {name}", f"Put the tip into mark '{name}' and hold it there; tilt the tool by 20° or more "
               "to all sides, and roll it.", 8.0)
        for name in marks
    ]  # fmt: skip
    return (
        Stroke("dome", "Coils off. Slide the tip over the whole dome in spirals, to the edge of the "
               "workspace; tilt the tool to all sides on the way.", 30.0),
        *stands,
        Stroke("roll", "Put the tool into a bore that fits, anywhere, and roll it by a full turn.", 10.0),
    )  # fmt: skip


def register_frame(
    device: SphericalElectromagnet,
    feed: Feed,
    *,
    prompt: Callable[[Stroke], bool],
    notify: Callable[[str], None],
    bar: Bar,
    pace: float = 1.0,
) -> FrameRegistration | None:
    """Record every stroke and compute the frame; None if the person stopped.

    Raises DriverError if no pose arrives, CalibrationError if the poses do not determine a frame.
    """
    steps, recordings = strokes(device), {}
    for number, stroke in enumerate((one.scale_time(pace) for one in steps), start=1):
        notify(f"{number}/{len(steps)} {stroke.name}: {stroke.instruction}")
        if not prompt(stroke):
            notify("stopped; no file was written")
            return None
        with bar(stroke.name, stroke.seconds) as passed:
            recordings[stroke.name] = _record_stroke(feed, stroke, passed)
        notify(f"    {len(recordings[stroke.name])} distinct poses")
    marks = {name.partition(" ")[2]: one for name, one in recordings.items() if name.startswith("mark ")}
    return frame_registration(TouchSession(recordings["dome"], marks, recordings["roll"]), device)


def _record_stroke(feed: Feed, stroke: Stroke, passed: Callable[[float], None]) -> Touches:
    """Return the poses of one stroke that differ from the previous one; poses queued before it are discarded."""
    for _ in range(_MAX_DISCARDED_READS):
        if not any(True for _ in feed.receive(0.0)):
            break
    p: list[Array] = []
    q: list[Array] = []
    refused: dict[str, int] = {}
    began = last = last_message = monotonic()
    valid = 0
    while (now := monotonic()) < began + stroke.seconds:
        for one in feed.receive(_POLL_TIMEOUT_S):
            why = one.why if isinstance(one, RejectedPose) else _describe_error(one)
            if why:
                refused[why] = refused.get(why, 0) + 1
                continue
            assert isinstance(one, RawPose)
            valid, last = valid + 1, monotonic()
            place, turn = np.array(one.p), np.array(one.q)
            if len(p) < _MAX_POSES and (not p or _has_moved(p[-1], q[-1], place, turn)):
                p.append(place)
                q.append(turn)
        if now - last > _SILENCE_TIMEOUT_S:
            break
        passed(now - last_message)
        last_message = now
    if not valid:
        what = ", ".join(f"{count} {why}" for why, count in refused.items()) or "nothing at all"
        raise DriverError(
            f"step '{stroke.name}': no pose arrived from the tracker ({what}); start its program, check that it "
            "sees the tool, and try again"
        )
    if sum(refused.values()) > valid:
        what = ", ".join(f"{count} {why}" for why, count in refused.items())
        raise CalibrationError(
            f"step '{stroke.name}': most messages had no valid pose ({what}, {valid} poses); is the tool seen from "
            "all sides, and is the message format as documented?"
        )
    return Touches.of(np.array(p), np.array(q), f"step '{stroke.name}'")


def _describe_error(one: RawPose) -> str:
    if not one.valid:
        return "lost"
    if len(one.p) != 3 or len(one.q) != 4:
        return "garbage"
    return "" if np.isfinite([*one.p, *one.q]).all() else "not finite"


def _has_moved(p: Array, q: Array, place: Array, turn: Array) -> bool:
    half = abs(float(q @ turn)) / max(float(np.linalg.norm(q) * np.linalg.norm(turn)), 1e-12)
    return float(np.linalg.norm(place - p)) > _MIN_MOTION_M or 2.0 * np.arccos(min(half, 1.0)) > _MIN_TURN_RAD


# --------------------------------------------------------------------------------------------------
# Rehearsal of the registration: a synthetic tracker that sends OSC, and a simulated person.


TIME_SCALE = 0.08  #: time scale of the simulated person
_REHEARSAL_RATE_HZ = 200.0  #: poses per second


def rehearsal_port(tracker: str) -> int:
    """Return the UDP port of `tracker`; InputError if it is not OSC on this computer."""
    kind, _, where = tracker.partition(":")
    host, _, port = where.rpartition(":")
    if kind != "osc" or host not in ("", "127.0.0.1", "localhost"):
        raise InputError(f"a rehearsal speaks OSC on this computer: --tracker osc:PORT; got '{tracker}'")
    return int(port)


class Rehearsal:
    """A simulated person with a synthetic tracker, drawn by `seed`, that sends to the UDP `port` of this computer."""

    def __init__(self, device: SphericalElectromagnet, port: int, seed: int = 0) -> None:
        self.tracker = SyntheticTracker.draw(seed)
        self._person = SimulatedPerson(device, self.tracker, seed)
        self._port = port
        self._own_port = 0  # source port of all strokes: a tracker feed accepts one sender

    @contextmanager
    def send_stroke(self, stroke: Stroke) -> Iterator[None]:
        """Send the poses of `stroke` from a thread, in real time."""
        over = threading.Event()
        n = max(int(_REHEARSAL_RATE_HZ * stroke.seconds), 40)
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
    """Return (rms position error [m], largest angle error [rad]) of the magnet over the dome, without noise."""
    still = SyntheticTracker(tracker.R, tracker.t, tracker.tip, tracker.axis, 0.0, 0.0)
    person, up = SimulatedPerson(device, still, 1).dome(n), device.tool.tip_distance
    places = person.point(tracker.tip + up * tracker.axis) @ tracker.R.T + tracker.t
    tip = person.point(found.tip + up * found.axis) @ found.R.T + found.t
    axes, axis = tracker.R @ person.R @ tracker.axis, found.R @ person.R @ found.axis
    off = float(np.sqrt(((places - tip) ** 2).sum(axis=1).mean()))
    return off, float(np.arcsin(np.clip(np.linalg.norm(np.cross(axes, axis), axis=1).max(), 0.0, 1.0)))
