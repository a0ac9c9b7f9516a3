"""A simulated device with a scripted hand in a test: the whole loop, stepped by its own clock or in real time."""

from __future__ import annotations

import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite
from haptorb.control.trip_reasons import GuardState, Trip
from haptorb.devices.base import Device, State
from haptorb.devices.loader import find_device
from haptorb.errors import InputError, WorldError
from haptorb.files import private_temporary_folder, replace_file
from haptorb.recording.mcap import Recorder
from haptorb.recording.recording import Recording
from haptorb.recording.row import LatestRow
from haptorb.runtime.assembly import assemble
from haptorb.runtime.config import RunConfig, choose_world
from haptorb.runtime.hand_file import choose_hand, parse_script
from haptorb.runtime.pointer import PointerTracker
from haptorb.runtime.servo import Servo
from haptorb.runtime.tick import StepWatch, render_world
from haptorb.runtime.tick_log import TickFailure
from haptorb.runtime.world_requests import change_world, description, name_of
from haptorb.serve.base import Serving, add_client_force, check_servers, hold_tool
from haptorb.simulation.hand_motion import SampledPath, ScriptedMotion
from haptorb.worlds import CATALOGUE
from haptorb.worlds.base import World
from haptorb.worlds.dynamic import BoundWorld

__all__ = ["TEMPORARY", "DeviceRun", "HandSource", "haptic_device", "scripted_hand"]

TEMPORARY = "haptorb-testrun-"  #: beginning of the name of a folder that is deleted with its run


# --------------------------------------------------------------------------------------------------
# The hand: a script as text, a file, or poses at times.


#: a motion, or what makes it for the device on which it is played
HandSource: TypeAlias = str | Path | ScriptedMotion | Callable[[Device], ScriptedMotion]


def scripted_hand(
    motion: str | Path | ArrayLike,
    times: ArrayLike | None = None,
    *,
    buttons: Mapping[float, Sequence[str]] | None = None,
) -> Callable[[Device], ScriptedMotion]:
    """Make a hand for `haptic_device` from a script, a file, or poses.

    Parameters
    ----------
    motion : str, Path or array_like, shape (n, 3) or (n, 7)
        The text of a script (it has a line break, or begins with `start`), the path of a hand file, or positions [m],
        with or without quaternions (x, y, z, w), at `times`.
    times : array_like, shape (n,), optional
        Times of the poses [s]; the hand goes straight between them and stays at the last one.
    buttons : Mapping, optional
        Time [s] → buttons that are pressed from then on, for poses: `{0.5: ["a"], 0.7: []}`.

    Returns
    -------
    callable
        (device) → the motion, checked for the device.

    Raises
    ------
    InputError
        If poses have no times; when the device is known: as for hand files.

    Examples
    --------
    >>> from haptorb import load
    >>> scripted_hand([(0, 0, 0.06), (0, 0, 0.05)], [0.0, 1.0])(load("omni")).at(0.5)[0].tolist()
    [0.0, 0.0, 0.055]
    """
    if isinstance(motion, str | Path):
        if times is not None or buttons is not None:
            raise InputError("times and buttons are for poses; a script or file states its own")
        if isinstance(motion, str) and ("\n" in motion or motion.lstrip().startswith("start")):
            return partial(parse_script, motion, path="the hand's script")
        return partial(_read, motion)
    if times is None:
        raise InputError("poses need times [s]: scripted_hand(poses, times)")
    return partial(_sample, motion, times, buttons or {})


def _read(path: str | Path, device: Device) -> ScriptedMotion:
    motion = choose_hand(path, device, "sim", "pointer")
    assert motion is not None
    return motion


def _sample(
    poses: ArrayLike, times: ArrayLike, buttons: Mapping[float, Sequence[str]], device: Device
) -> ScriptedMotion:
    path = SampledPath(poses, times, upright=device.is_upright)
    order = sorted(buttons)
    bits = [sum(1 << "abc".index(name) for name in buttons[t]) for t in order]
    if not device.kind.modes:
        device.check_hand_goals(path.poses[:, :3], "the hand's path")
    return ScriptedMotion(path, presses=(order, bits))


def _choose_hand(hand: HandSource | None, device: Device) -> ScriptedMotion | None:
    return hand(device) if callable(hand) else choose_hand(hand, device, "sim", "pointer")


# --------------------------------------------------------------------------------------------------
# The run: the chain of a servo, stepped here by its own clock, or a servo in its own process.


class DeviceRun(ABC):
    """A simulated device with a hand, in a `with` block of `haptic_device`.

    Attributes
    ----------
    device : Device
        The simulated device.
    hand : ScriptedMotion or None
        Motion of the hand; None: the guided motion of the kind of device.
    """

    device: Device
    hand: ScriptedMotion | None

    @property
    @abstractmethod
    def t(self) -> float:
        """Time on the loop's clock [s]."""

    @abstractmethod
    def play(self, seconds: float | None = None) -> None:
        """Run the loop for a time.

        Parameters
        ----------
        seconds : float, optional
            How long [s]; None: to the end of the hand's motion.

        Raises
        ------
        WorldError
            If the world's code fails.
        InputError
            If `seconds` is negative or not finite, or is left out without a hand's motion.
        """

    @abstractmethod
    def latest(self) -> LatestRow:
        """Return the newest tick, by field name, in SI units.

        Raises
        ------
        ServoError
            Before the first tick, in real time.
        InputError
            Before the first tick, without real time.
        """

    @abstractmethod
    def set_world(self, name: str, **values: Any) -> None:
        """Render another world, or the same with other parameters, from the next tick on.

        Parameters
        ----------
        name : str
            Name in the catalogue, or of the world at the start.
        **values
            Parameters; those not given stay the same, or are the defaults of a new world.

        Raises
        ------
        UnknownName
            If there is no such world or parameter.
        InputError
            If a value is invalid.
        """

    @property
    @abstractmethod
    def recording(self) -> Recording:
        """Recording of all ticks so far; also available after the block."""

    def _find_duration(self, seconds: float | None) -> float:
        if seconds is None:
            if self.hand is None:
                raise InputError("play() needs a time [s] without a motion of the hand: play(2.0), or hand=…")
            return max(self.hand.duration - self.t, 0.0)
        duration = float(check_finite(seconds, "seconds"))
        if duration < 0.0:
            raise InputError(f"seconds must not be negative; got {seconds!r}")
        return duration


@final
class _WholeDetail(StepWatch):
    """Step watch that never reduces a world's detail: without real time, a long step does no harm."""

    def begin(self, bound: BoundWorld) -> None:
        """Do nothing."""

    def end(self, bound: BoundWorld) -> TickFailure:
        """Report no failure."""
        return TickFailure(0)


@final
class _SteppedRun(DeviceRun):
    """The chain of a servo, stepped by its own clock as fast as it computes."""

    def __init__(self, config: RunConfig, file: Path) -> None:
        self._config, self._file = config, file
        self.device, self.hand, self._rate = config.device, config.hand, config.rate
        self._world, self._ticks = config.world, 0
        self._chain = assemble(config, PointerTracker())
        self._chain.budget = _WholeDetail()
        self._layout = self._chain.layout
        self._rows: list[Array] = []
        self._changes = [(0, description(self._world))]
        name = name_of(self._world)
        self._own = {} if type(self._world) is CATALOGUE.get(name) else {name: self._world}
        self._kept: Recording | None = None

    @contextmanager
    def open(self) -> Iterator[DeviceRun]:
        """Keep the driver open in the block; the recording is complete after it."""
        with self._chain.driver:
            yield self
        if self._rows:
            _ = self.recording

    @property
    def t(self) -> float:
        """Time of the next tick [s]."""
        return self._ticks / self._rate

    def play(self, seconds: float | None = None) -> None:
        """Step the loop; a tick at the end belongs to it."""
        last = self._ticks + round(self._find_duration(seconds) * self._rate) + (seconds is None)
        at = self._layout
        guard, trip = at["guard"].start, at["trip"].start
        rows = np.full((max(last - self._ticks, 0), at.width), np.nan)
        self._kept = None
        for row in rows:
            number, now = self._ticks, round(self._ticks / self._rate, 9)
            self._chain.prepare(now)
            self._chain.step(row, now)
            row[at["tick"]], row[at["wall"]] = number, now
            row[at["lateness"]] = row[at["missed"]] = row[at["stages"]] = row[at["ahead"]] = 0.0
            bits, grip = (0, np.nan) if self.hand is None else self.hand.signals_at(now)
            row[at["buttons"]], row[at["grip"]] = bits, grip
            row[at["hand_t"]] = np.nan if self.hand is None else now
            self._ticks += 1
            if row[guard] == GuardState.TRIPPED and row[trip] in (Trip.WORLD_FAILED, Trip.MEMORY_NOT_FINITE):
                self._rows.append(rows[: len(rows) - (last - self._ticks)])
                raise WorldError(f"at {now:.3f} s: {self._chain.error}\nThe coils are off.")
        self._rows.append(rows)

    def latest(self) -> LatestRow:
        """The newest tick."""
        if not self._ticks:
            raise InputError("no tick yet: play(seconds) lets time pass")
        return LatestRow(self._layout, next(rows for rows in reversed(self._rows) if len(rows))[-1])

    def set_world(self, name: str, **values: Any) -> None:
        """Set the world from the next tick on."""
        world = change_world(self._world, name, values, self._own)
        render_world(self._chain, world, self._world)
        self._world = world
        self._changes.append((self._ticks, description(world)))

    @property
    def recording(self) -> Recording:
        """All ticks so far, written to the file."""
        if self._kept is None:
            with replace_file(self._file) as part, part.open("wb") as file:  # a link of that name is not followed
                recorder = Recorder(file, self._layout, self._rate, 0)
                for name, values in self._config.notes(self._own.values()).items():
                    recorder.add_metadata(name, values)
                for change, (tick, text) in enumerate(self._changes):
                    recorder.add_metadata("world", {"change": str(change), "tick": str(tick), "world": text})
                for rows in self._rows:
                    recorder.append(rows)
                recorder.finish()
            self._kept = Recording(self._file)
        return self._kept


@final
class _RealTimeRun(DeviceRun):
    """A servo in its own process, with servers for other programs."""

    def __init__(self, servo: Servo, hand: ScriptedMotion | None, serving: Serving) -> None:
        self.device, self.hand, self.servo, self._serving = servo.device, hand, servo, serving

    @contextmanager
    def open(self) -> Iterator[DeviceRun]:
        """The servo runs in the block."""
        with self.servo:
            try:
                self._serving.start()
                yield self
            finally:
                self.servo.end_loop()
                self._serving.end()

    @property
    def t(self) -> float:
        """Time of the newest tick [s]."""
        return float(self.servo.latest().t)

    def play(self, seconds: float | None = None) -> None:
        """Wait while the loop runs."""
        self.servo.run(self._find_duration(seconds))

    def latest(self) -> LatestRow:
        """The newest tick."""
        return self.servo.latest()

    def set_world(self, name: str, **values: Any) -> None:
        """Set the world from the next tick on."""
        self.servo.set_world(name, values)

    @property
    def recording(self) -> Recording:
        """The recording so far."""
        return self.servo.recording


@contextmanager
def haptic_device(
    device: str | Path | Device = "omni",
    world: str | World | Callable[[State], Array] | None = None,
    *,
    hand: HandSource | None = None,
    rate: float = 1000.0,
    seed: int = 0,
    model: str | None = None,
    estimator: str | None = None,
    render: str | None = None,
    torque_arm: float | None = None,
    grip: str = "light",
    record: str | Path | None = None,
    real_time: bool = False,
    serve: Sequence[str] = (),
) -> Iterator[DeviceRun]:
    """Run a simulated device in a test.

    Parameters
    ----------
    device : str, Path or Device
        Name in the catalogue, path of a device file, or a Device.
    world : str, World, callable or None
        Name in the catalogue, "FILE.py:NAME", a World, or a function of a State that returns a wrench (6,) [N, N·m];
        None: the default world of the kind of device, or the force of clients with `serve`.
    hand : str, Path, ScriptedMotion or callable, optional
        File or motion of `scripted_hand`; None: the guided motion of the kind of device.
    rate : float
        Rate of the loop [Hz].
    seed : int
        Seed of the simulation: it chooses the device's deviations and noise.
    model : str, optional
        Controller model, one of the device's `tick_models`; None: the first.
    estimator : str, optional
        Name of the estimator; None: the device's default.
    render : str, optional
        Part of the world's wrench to render, "force", "torque" or "both"; None: the part that the world defines.
    torque_arm : float, optional
        Length that weights torque against force if both are rendered [m]; None: 43.5 mm.
    grip : str
        Hand for which the coupling of a scene is chosen, as for `haptorb.Servo`.
    record : str or Path, optional
        File of the recording (MCAP); it is replaced. None: a temporary one, which is deleted with the run.
    real_time : bool
        True: a servo in its own process, by the computer's clock, as `haptorb run` has it.
    serve : sequence of str
        Servers for other programs, as `haptorb run --serve`; they need `real_time`.

    Yields
    ------
    DeviceRun
        `play` lets time pass; `recording` has all ticks, also after the block.

    Raises
    ------
    InputError
        If a value is invalid, or world or hand do not fit the device.
    UnknownName
        If a device, world, estimator or model does not exist.

    Examples
    --------
    >>> with haptic_device("omni", "nothing", hand=scripted_hand("start 0 0 60 mm")) as run:
    ...     run.play(0.01)
    >>> len(run.recording)
    10
    """
    found = find_device(device)
    motion = _choose_hand(hand, found)
    if serve and not real_time:
        raise InputError("serve needs real_time=True: other programs have a clock of their own")
    choices = check_servers(list(serve))
    chosen, _ = choose_world(("remote" if serve else found.kind.world) if world is None else world)
    config = RunConfig.of(
        found, add_client_force(chosen, choices), rate=rate, seed=seed, model=model, estimator=estimator,
        render=render, torque_arm=torque_arm, grip=grip, hand=motion,
    )  # fmt: skip
    folders = ExitStack()
    if record is None:
        record = folders.enter_context(private_temporary_folder("testrun")) / "run.mcap"
    file = Path(record)
    run: _SteppedRun | _RealTimeRun
    try:
        if real_time:
            servo = Servo(hold_tool(config, choices), record=file, overwrite=True)
            run = _RealTimeRun(servo, config.hand, Serving(choices, servo))
        else:
            run = _SteppedRun(config, file)
    except BaseException:
        folders.close()
        raise
    weakref.finalize(run, folders.close)
    with run.open():
        yield run
