"""What a recording says of the chain that made it: device, calibration, estimator, worlds; and that chain once more."""

from __future__ import annotations

import json
from base64 import b64decode
from collections.abc import Mapping
from typing import Any, final

import numpy as np

from haptorb import worlds
from haptorb.control.clutch.gains import Gains
from haptorb.devices.device import Device
from haptorb.devices.device_text import DeviceText
from haptorb.devices.loader import catalogue, load, parse
from haptorb.errors import HaptorbError, InputError, RecordingError
from haptorb.runtime.drivers.driver import Driver
from haptorb.runtime.exchange.world_change import description
from haptorb.runtime.recording.recording import Recording
from haptorb.runtime.recording.software import describe_machine, list_versions
from haptorb.runtime.tick.assembly import default_world, estimators_of, make_tick
from haptorb.runtime.tick.tick import Tick
from haptorb.sensing.calibration.calibration import Calibration
from haptorb.worlds.dynamic.remote import Remote
from haptorb.worlds.dynamic.remote_sum import join_remote, split_remote
from haptorb.worlds.own.world_file import find_world_file
from haptorb.worlds.own.world_note import load_noted_world
from haptorb.worlds.world import World

__all__ = ["RecordedRun"]


@final
class RecordedRun:
    """The notes of `recording`, as the objects that they describe.

    device    as its file in the recording says
    rate      of the loop [Hz]
    remarks   what could not be made again as it was, and what stands in for it

    Raises RecordingError if the recording does not say which device it is of.
    """

    def __init__(self, recording: Recording) -> None:
        self.remarks: list[str] = []
        self._path, self._notes = recording.path, recording.metadata
        self._run: Mapping[str, str] = self._notes.get("run", {})
        self.device: Device = self._load_device()
        self.rate = self._number("rate_hz") or self._measure_rate(recording)
        estimator, known = self._run.get("estimator", ""), estimators_of(self.device)
        self.estimator: str = estimator if estimator in known else known[0]
        if estimator not in ("", self.estimator):
            self.remarks.append(f"estimator '{estimator[:60]}' is unknown to this version; '{self.estimator}' is used")
        self.model: str | None = self._run.get("model") or None
        if self.model is not None and self.model not in self.device.models:
            self.remarks.append(f"model '{self.model}' is unknown to this version; '{self.device.models[0]}' is used")
            self.model = None
        self._descriptions = self._read_descriptions(recording)
        self._made = self._read_object("worlds")
        self._worlds: dict[int, World] = {}
        self.code: dict[str, str] = {}  #: world → file and name of this account's own code that runs for it

    @property
    def software(self) -> Mapping[str, str]:
        """What made the recording, and on which processor, as far as it says."""
        return {**self._notes.get("versions", {}), **self._notes.get("machine", {})}

    @property
    def same_software(self) -> bool:
        """Whether the software and the processor of this computer made the recording."""
        return self.software == {**list_versions(), **describe_machine()}

    def describe_software(self) -> str:
        """What is not as it is here: "haptorb 0.9 (here 1.0)"."""
        made, here = self.software, {**list_versions(), **describe_machine()}
        apart = [name for name in here if made.get(name) != here[name]]
        if not any(name in made for name in apart):
            return "another versionof unknown number"
        return ", ".join(f"{name} {made.get(name, 'unknown')} (here {here[name]})" for name in apart)

    def make_tick(
        self, world: World, driver: Driver, rate: float, estimator: str | None = None, model: str | None = None
    ) -> Tick:
        """The chain behind `driver` at `rate` [Hz], with another `estimator` or `model` if one is given.

        Raises what `make_tick` of the assembly raises.
        """
        run = self._run
        gains = self._read_object("gains")
        text = run.get("calibration", "")
        return make_tick(
            self.device, world, driver, rate, model or self.model,
            estimator=estimator or self.estimator,
            gains=Gains(**{name: tuple(value) for name, value in gains.items()}) if gains else None,
            calibration=Calibration.parse(text, f"the calibration in {self._path}") if text else None,
            render=run.get("render") or None,
            torque_arm=self._number("torque_arm_m"),
            in_turns=run.get("driver", "sim") not in ("", "sim"),
            learned=self._read_learned() if estimator in (None, self.estimator) else b"",
        )  # fmt: skip

    def describe_world(self, change: int) -> str:
        """The note of the world after `change` changes; empty if the recording has none."""
        return self._descriptions.get(change, "")

    def world(self, change: int) -> World:
        """The world after `change` changes of it, made again. Raises InputError with the reason if it cannot be."""
        if change not in self._worlds:
            self._worlds[change] = self._make_world(change)
        return self._worlds[change]

    def remote(self, change: int) -> Remote | None:
        """The clients' force beside the world after `change` changes; None where none was."""
        try:
            values = json.loads(self.describe_world(change)).get("remote")
        except (ValueError, AttributeError, RecursionError):
            return None
        if values is None:
            return None
        remote = Remote()
        return remote.replace(**values) if isinstance(values, dict) else remote

    def _make_world(self, change: int) -> World:
        text = self.describe_world(change)
        try:
            note = json.loads(text)
            name, values = str(note["name"]), dict(note.get("values", {}))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as cause:
            raise InputError("the recording does not state the world") from cause
        if name in self._made:
            world = load_noted_world(str(self._made[name]))
            if found := find_world_file(world):
                self.code[name] = f"{found[0]} ({found[1]})"
        elif name in worlds.CATALOGUE:
            world = worlds.find_world(name)()
        else:
            raise InputError("the recording does not state its source")
        plain, _ = split_remote(world)
        world = join_remote(plain.replace(**values) if values else plain, self.remote(change))
        if json.loads(description(world)) != note:
            raise InputError("this version of haptorb describes it differently")
        return world

    def _read_descriptions(self, recording: Recording) -> dict[int, str]:
        found = {}
        for note in recording.worlds:
            if (number := note.get("change", "")).isdecimal():
                found[int(number)] = note.get("world", "")
        first = self._run.get("first_world", "")
        if 0 not in found and first:
            found[0] = first
        if not found:  # of an old one
            found[0] = json.dumps({"name": default_world(self.device), "values": {}})
        return found

    def _read_object(self, key: str) -> dict[str, Any]:
        try:
            found = json.loads(self._run.get(key) or "{}")
        except (ValueError, RecursionError):
            found = {}
        return found if isinstance(found, dict) else {}

    def _read_learned(self) -> bytes:
        """What the run's estimator had learned; empty in recordings that do not carry it."""
        try:
            return b64decode(self._run.get("learned", ""), validate=True)
        except ValueError:
            return b""

    def _number(self, key: str) -> float | None:
        try:
            number = float(self._run.get(key, ""))
        except ValueError:
            return None
        return number if np.isfinite(number) and number > 0.0 else None

    def _measure_rate(self, recording: Recording) -> float:
        steps = np.diff(recording["t"][:1000])
        steps = steps[steps > 0]
        if not len(steps):
            raise RecordingError(f"{self._path} cannot be replayed: it does not state its rate")
        return float(1.0 / np.median(steps))

    def _load_device(self) -> Device:
        noted = self._notes.get("device", {})
        text, name, digest = DeviceText.from_note(noted), noted.get("name", ""), noted.get("digest", "")
        try:
            if text:
                device = parse(text.own, f"the device in {self._path}", bases=text.bases)
            elif name in catalogue():
                device = load(name)
            else:
                raise RecordingError(f"{self._path} cannot be replayed: it does not contain the device file")
        except RecordingError:
            raise
        except HaptorbError as cause:
            raise RecordingError(f"{self._path} cannot be replayed: {cause}") from cause
        if device.digest != digest:
            self.remarks.append(f"device '{name}' is not the one of the recording: its file has changed since")
        return device
