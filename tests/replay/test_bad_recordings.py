"""Recordings that can be replayed only in part: the missing part is reported."""

from __future__ import annotations

import json
import os
import pickle
import resource
import zlib
from base64 import b64encode
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from haptorb import Recording
from haptorb.arrays import Array, StateArray
from haptorb.devices.loader import load
from haptorb.errors import HaptorbError, RecordingError
from haptorb.recording.mcap import Recorder
from haptorb.recording.row import RowLayout
from haptorb.recording.state_notes import LAYOUT_NOTE, STATE_NOTE, describe_arrays, pack_arrays, unpack_arrays
from haptorb.replay.parallel import replay_in_parts
from haptorb.replay.recorded_run import list_memory_fields
from haptorb.replay.replay import Replay, check_replay_file
from haptorb.runtime.tick_state import save_state
from haptorb.worlds import Fluid, PathGuidance, RollingBall, World
from haptorb.worlds.client_force import Remote
from haptorb.worlds.path import make_shape
from haptorb.worlds.user_world import WorldFile, load_noted_world, note_start
from oracles.made_recording import make_recording
from oracles.recorded_chain import Deed, record_chain

State = Mapping[str, StateArray]
OLDER = Path(__file__).parents[1] / "contracts" / "older"
GROOVE = """
import numpy as np
from dataclasses import dataclass
from haptorb.worlds import World
from haptorb.worlds.base import parameter

@dataclass(frozen=True)
class Groove(World):
    depth: float = parameter(1.0, "N", 0.0, 5.0, "of the groove")

    def wrench(self, state):
        return np.array([self.depth * state.p[0] * 20, 0, 0, 0, 0, 0])
"""


def rewrite(recording: Recording, path: Path, drop: tuple[str, ...] = (), **changes: dict[str, str]) -> Recording:
    """The same rows with other notes: `drop` leaves some out, `changes` replace values in others."""
    with path.open("wb") as file:
        recorder = Recorder(file, recording.layout, 1000.0, 0)
        for name, values in recording.notes:
            short = name.removeprefix("haptorb/")
            if short not in (*drop, "layout", "clock"):
                recorder.add_metadata(short, {**values, **changes.get(short, {})})
        recorder.append(recording.rows)
        recorder.finish()
    return Recording(path)


@pytest.mark.parametrize("number", ["9" * 5000, "٣", "²", "-1", ""])
def test_a_change_of_the_world_has_a_number_that_can_be_read(tmp_path: Path, number: str) -> None:
    """Python refuses to convert thousands of digits."""
    whole = record_chain(tmp_path / "run.mcap", ticks=40)
    other = rewrite(whole, tmp_path / "other.mcap", world={"change": number})
    assert Replay(other).run().compared == 40


def test_a_truncated_file_replays_as_far_as_it_goes(tmp_path: Path) -> None:
    whole = record_chain(tmp_path / "run.mcap")
    content = whole.path.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(content) * 2 // 3])
    replay = Replay(Recording(tmp_path / "cut.mcap"))
    found = replay.run()
    assert found.identical
    assert 0 < found.compared < 300
    assert any("cut short" in remark for remark in replay.remarks)


def test_an_older_recording_replays_nearly(tmp_path: Path) -> None:
    """It does not hold the samples: what the estimator made of them stands in, and the world's wrench is recorded."""
    replay = Replay(Recording(OLDER / "omni.mcap"))
    found = replay.run()
    assert replay.approximate
    assert "pose_p" in replay.missing
    apart = {one.field: one for one in found.bounds}
    assert "wrench_commanded" not in apart or apart["wrench_commanded"].largest < 1e-15  # its gain is computed again
    assert apart["current_commanded"].largest < 0.2 * apart["current_commanded"].greatest
    assert any("recorded wrench" in remark for remark in replay.remarks)


def test_a_recording_without_its_device_is_refused(tmp_path: Path) -> None:
    make_recording(tmp_path / "run.mcap", 0.1, device=False)
    with pytest.raises(RecordingError, match="device"):
        Replay(Recording(tmp_path / "run.mcap"))


def test_a_recording_of_no_rows_is_refused(tmp_path: Path) -> None:
    recording = record_chain(tmp_path / "run.mcap", ticks=1)
    path = tmp_path / "empty.mcap"
    with path.open("wb") as file:
        recorder = Recorder(file, recording.layout, 1000.0, 0)
        recorder.finish()
    with pytest.raises(RecordingError, match="no rows"):
        Replay(Recording(path))


def test_rows_of_something_else_are_refused(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        kind = writer.register_schema("haptorb/msg/Tick", "ros2msg", b"float64 speed  # [m/s] of a car\n")
        channel = writer.register_channel("/haptorb/tick", "cdr", kind)
        writer.add_message(channel, 0, b"\0\1\0\0" + np.zeros(1).tobytes(), 0)
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(RecordingError, match="no field"):
        Replay(Recording(path))


@pytest.mark.parametrize(
    "text",
    ["", "no json", "{}", '{"made": {"kind": "os:system", "fields": {"command": "false"}}}', '{"made": 3}', "[1]",
     '{"code": {"file": "/etc/passwd", "name": "x", "digest": "0", "loaded": "yes"}}',
     '{"made": {"kind": "haptorb.worlds.dome:Dome", "fields": {"speed": 1.0}}}'],
)  # fmt: skip
def test_a_note_of_a_world_that_cannot_be_made_leaves_the_recorded_wrench(text: str, tmp_path: Path) -> None:
    recording = record_chain(tmp_path / "run.mcap", world=Fluid(viscosity=3.0))
    replay = Replay(rewrite(recording, tmp_path / "other.mcap", run={"worlds": json.dumps({"fluid": text})}))
    found = replay.run()
    assert found.identical, found.first
    assert any("recorded wrench" in remark for remark in replay.remarks)


def test_a_path_that_no_kernel_could_follow_leaves_the_recorded_wrench(tmp_path: Path) -> None:
    """In a process with an end: compiled code that searches along it does not return, or reads beyond its arrays."""
    recording = record_chain(tmp_path / "run.mcap", world=PathGuidance(path=make_shape("circle")), ticks=40)
    note = json.loads(json.loads(recording.metadata["run"]["worlds"])["path_guidance"])
    note["made"]["fields"]["path"]["fields"]["spacing"] = 1e-12
    worlds = json.dumps({"path_guidance": json.dumps(note)})
    other = rewrite(recording, tmp_path / "other.mcap", run={"worlds": worlds})

    def run() -> bool:
        replay = Replay(other)
        return replay.run().identical and any("recorded wrench" in remark for remark in replay.remarks)

    assert try_in_child(run, 20.0)


def try_in_child(work: Callable[[], bool], seconds: float) -> bool:
    """Whether `work` returns True in a forked process within `seconds` of the processor."""
    pid = os.fork()
    if pid == 0:
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
        code = 1
        with suppress(BaseException):
            code = 0 if work() else 1
        os._exit(code)
    return os.waitpid(pid, 0)[1] == 0


@pytest.mark.parametrize("after", [1, 30])
def test_a_recording_changes_its_world_no_more_often_than_it_says(after: int, tmp_path: Path) -> None:
    """Each change takes as long as some ticks; a thousand may be those of notes that cannot be read."""

    def change(rows: Array) -> None:
        world = RowLayout.of(load("omni"))["world"].start
        rows[after:, world] = 900.0 * np.arange(1, len(rows) - after + 1)

    recording = record_chain(tmp_path / "run.mcap", ticks=40, change=change)
    with pytest.raises(RecordingError, match="describes 1 changes"):
        Replay(recording).run()


def test_a_world_is_made_once_however_often_a_run_changes_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    deeds: dict[int, Deed] = {n: lambda tick: tick.change_world(Fluid(viscosity=3.0)) for n in range(5, 25)}
    recording = record_chain(tmp_path / "run.mcap", world=Fluid(viscosity=3.0), deeds=deeds, ticks=40)
    made: list[str] = []

    def load_world(text: str) -> World:
        made.append(text)
        return load_noted_world(text)

    monkeypatch.setattr("haptorb.replay.recorded_run.load_noted_world", load_world)
    assert Replay(recording).run().identical
    assert len(made) == 1


@pytest.mark.parametrize(
    "gains",
    ['{"x": [1]}', '{"translate": 1}', '{"translate": [1, 2]}', '{"translate": [1, 2, "x"]}', '{"translate": "abc"}',
     '{"translate": [1e999, 0, 0]}', '{"translate": [[1], 2, 3]}', f'{{"translate": [{"9" * 400}, 1, 1]}}',
     '{"translate": {"a": 1}}', '{"translate": null}', '{"translate_torque": true}', '{"\\u001b[2J": [1, 2, 3]}'],
)  # fmt: skip
def test_gains_that_are_none_are_refused(gains: str, tmp_path: Path) -> None:
    recording = record_chain(tmp_path / "run.mcap", "pmsm", ticks=5)
    with pytest.raises(RecordingError, match="gains") as told:
        Replay(rewrite(recording, tmp_path / "other.mcap", run={"gains": gains}))
    assert str(told.value).isprintable()


def test_a_replay_needs_neither_tracker_nor_frame_nor_coupling(tmp_path: Path) -> None:
    recording = record_chain(tmp_path / "run.mcap", ticks=20, tracker="osc:9000")
    foreign = {"tracker": "mouse", "frame": "{}", "coupling": '{"mass_kg": 0}', "watchdog": "off"}
    assert Replay(rewrite(recording, tmp_path / "other.mcap", run=foreign)).run().identical


def test_a_world_of_a_file_runs_if_this_account_started_it_and_the_file_is_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    file = tmp_path / "groove.py"
    file.write_text(GROOVE)
    world = WorldFile(file).load().replace(depth=2.0)
    recording = record_chain(tmp_path / "run.mcap", world=world)
    replay = Replay(recording)
    assert replay.run().identical
    assert replay.recorded.code == {}
    assert any("not executed" in remark for remark in replay.remarks)
    note_start(world)
    replay = Replay(recording)
    assert replay.run().identical
    assert replay.remarks == []
    assert list(replay.recorded.code.values()) == [f"{file} (Groove)"]
    file.write_text(GROOVE.replace("* 20", "* 21"))
    for word in ("changed", "missing"):
        if word == "missing":
            file.unlink()
        replay = Replay(recording)
        found = replay.run()
        assert found.identical, found.first
        assert any(word in remark for remark in replay.remarks)


@pytest.mark.parametrize("shape", [[10**12], [-1], [10**6, 10**6], [2**80]])
def test_a_memory_longer_than_any_row_is_none(shape: list[int]) -> None:
    field = {"name": "place", "unit": "m", "about": "of it", "shape": shape}
    assert list_memory_fields(json.dumps({"name": "own", "memory": [field]})) == ()


def test_another_version_is_named(tmp_path: Path) -> None:
    recording = record_chain(tmp_path / "run.mcap")
    assert Replay(recording).recorded.same_software
    newer = rewrite(recording, tmp_path / "newer.mcap", versions={"haptorb": "99.0"})
    replay = Replay(newer)
    assert replay.run().identical
    assert not replay.recorded.same_software
    assert "99.0" in replay.recorded.describe_software()


def test_a_device_that_has_changed_is_told(tmp_path: Path) -> None:
    recording = record_chain(tmp_path / "run.mcap")
    text = recording.metadata["device"]["file"].replace('title = "', 'title = "Another ')
    replay = Replay(rewrite(recording, tmp_path / "other.mcap", device={"file": text}))
    assert replay.run().identical
    assert any("device" in remark for remark in replay.remarks)


@pytest.mark.parametrize("kept", [True, False])
def test_after_lost_ticks_it_goes_on_where_the_state_is_known(kept: bool, tmp_path: Path) -> None:
    states: list[State] = []
    deeds: dict[int, Deed] = {
        155: lambda tick: tick.change_world(RollingBall()),
        201: lambda tick: states.append(save_state(tick)),
        250: lambda tick: tick.stop(),
    }
    whole = record_chain(tmp_path / "run.mcap", deeds=deeds)
    path = tmp_path / "lost.mcap"
    with path.open("wb") as file:
        recorder = Recorder(file, whole.layout, 1000.0, 0)
        for name, values in whole.notes:
            if (short := name.removeprefix("haptorb/")) not in ("layout", "clock"):
                recorder.add_metadata(short, values)
        if kept:
            note_state(recorder, 200, states[0])
        recorder.append(np.concatenate((whole.rows[:150], whole.rows[160:])))
        recorder.finish()
    replay = Replay(Recording(path))
    found = replay.run()
    assert found.identical, found.first
    assert found.compared == (150 + 99 if kept else 150)
    assert any("lost" in remark for remark in replay.remarks)


@pytest.mark.parametrize("room", [2, 4])
def test_rows_too_narrow_for_what_a_client_commanded_leave_the_recorded_wrench(room: int, tmp_path: Path) -> None:
    whole = record_chain(tmp_path / "run.mcap", world=Remote())
    narrow = replace(whole.layout, memory=room)
    path = tmp_path / "narrow.mcap"
    with path.open("wb") as file:
        recorder = Recorder(file, narrow, 1000.0, 0)
        for name, values in whole.notes:
            if (short := name.removeprefix("haptorb/")) not in ("layout", "clock"):
                recorder.add_metadata(short, values)
        recorder.append(whole.rows[:, : narrow.width])
        recorder.finish()
    with pytest.raises(RecordingError, match=r"narrow\.mcap.*memory.*recorded wrench"):
        Replay(Recording(path))
    replay = Replay(Recording(path), recorded_world=True)
    assert "wrench_commanded" not in {one.field for one in replay.run().bounds}


def note_state(recorder: Recorder, tick: int, state: State) -> None:
    """As the recorder does."""
    recorder.add_metadata(LAYOUT_NOTE, {"arrays": describe_arrays(state)})
    recorder.add_metadata(STATE_NOTE, {"tick": str(tick), "arrays": pack_arrays(state)})


def late(recording: Recording, path: Path, first: int, notes: dict[str, dict[str, str]]) -> Recording:
    """The recording from tick `first` on, as a black box."""
    with path.open("wb") as file:
        recorder = Recorder(file, recording.layout, 1000.0, 0)
        for name, values in recording.notes:
            if (short := name.removeprefix("haptorb/")) not in ("layout", "clock"):
                recorder.add_metadata(short, values)
        for name, values in notes.items():
            recorder.add_metadata(name, values)
        recorder.append(recording.rows[first:])
        recorder.finish()
    return Recording(path)


@pytest.mark.parametrize(("device", "estimator"), [("omni", "hall"), ("omni", None), ("pmsm", None)])
def test_a_recording_that_begins_in_the_middle_goes_on_from_the_kept_state(
    device: str, estimator: str | None, tmp_path: Path
) -> None:
    kept: list[State] = []
    deeds: dict[int, Deed] = {121: lambda tick: kept.append(save_state(tick)), 200: lambda tick: tick.stop()}
    if device == "omni":
        deeds[60] = lambda tick: tick.change_world(RollingBall())
    else:
        deeds[60] = lambda tick: tick.joining.set_mode("rotate")
    whole = record_chain(tmp_path / "run.mcap", device, estimator=estimator, deeds=deeds)
    notes = {
        LAYOUT_NOTE: {"arrays": describe_arrays(kept[0])},
        STATE_NOTE: {"tick": "120", "arrays": pack_arrays(kept[0])},
    }
    replay = Replay(late(whole, tmp_path / "late.mcap", 120, notes))
    found = replay.run()
    assert found.identical, found.first
    assert not replay.approximate
    without = Replay(late(whole, tmp_path / "without.mcap", 120, {}))
    without.run()
    assert without.approximate


LAYOUTS = {
    "none": "", "no json": "[[", "no list": "{}", "no array": "[[1, 2, 3]]", "object": '[["a", "|O", [1]]]',
    "subarray": '[["a", "(1000000000,)<f8", [1]]]', "records": '[["a", "<f8,<f8", [1]]]', "void": '[["a", "|V8", [1]]]',
    "text": '[["a", "<U2", [1]]]', "negative": '[["a", "<f8", [-1]]]', "huge": '[["a", "<f8", [1000000000000]]]',
    "huge twice": '[["a", "<f8", [1000000, 1000000, 1000000, 1000000]]]', "true": '[["a", "<f8", [true]]]',
    "fraction": '[["a", "<f8", [1.5]]]', "twice": '[["a", "<f8", [0]], ["a", "<f8", [1]]]', "deep": "[" * 100000,
    "long": '[["a", "<f8", [7]]]', "short": '[["a", "<f8", [9]]]', "other": '[["a", "<f8", [8]]]',
    "bools": '[["a", "|b1", [64]]]', "many": json.dumps([[str(n), "<f8", [0]] for n in range(5000)]),
}  # fmt: skip


@pytest.mark.parametrize("kind", LAYOUTS)
def test_a_state_that_is_none_is_refused(kind: str, tmp_path: Path) -> None:
    whole = record_chain(tmp_path / "run.mcap")
    text = pack_arrays({"a": np.frombuffer(bytes(range(64)), np.float64)})
    notes = {LAYOUT_NOTE: {"arrays": LAYOUTS[kind]}, STATE_NOTE: {"tick": "120", "arrays": text}}
    with pytest.raises(RecordingError, match="state"):
        Replay(late(whole, tmp_path / "late.mcap", 120, notes))


@pytest.mark.parametrize("length", [7, 9])
def test_a_state_has_all_of_its_numbers_and_no_more(length: int) -> None:
    with pytest.raises(RecordingError, match="state"):
        unpack_arrays(f'[["a", "<f8", [{length}]]]', pack_arrays({"a": np.zeros(8)}))


@pytest.mark.parametrize("text", ["", "%%%", "AAAA", b64encode(zlib.compress(bytes(1 << 24))).decode()])
def test_a_state_whose_numbers_are_none_is_refused(text: str, tmp_path: Path) -> None:
    whole = record_chain(tmp_path / "run.mcap")
    notes = {
        LAYOUT_NOTE: {"arrays": '[["a", "<f8", [8]]]'}, STATE_NOTE: {"tick": "120", "arrays": text},
    }  # fmt: skip
    with pytest.raises(RecordingError, match="state"):
        Replay(late(whole, tmp_path / "late.mcap", 120, notes))


def spoil(state: State, name: str, value: object) -> dict[str, StateArray]:
    """The state with another array of that name; None: without it."""
    found = {key: one for key, one in state.items() if key != name or value is not None}
    assert name in state
    if value is not None:
        found[name] = np.asarray(value)
    return found


@pytest.mark.parametrize(
    ("name", "value"),
    [("tick/rendered", None), ("tick/rendered", np.zeros(7)), ("tick/rendered", np.zeros(6, np.int64)),
     ("tick/protection/state/guard/state", np.array([99])), ("tick/protection/state/guard/reason", np.array([-5])),
     ("tick/part/part/part", np.array([1e300])), ("tick/part/part/part", np.array([-1.0])),
     ("tick/counts/world_changes", np.array([np.nan])), ("tick/counts/mode", np.array([3.0])),
     ("tick/estimator:tracker/model/change/before", np.array([7.0])),
     ("tick/estimator:tracker/estimate/disbelieved", np.array([np.inf]))],
)  # fmt: skip
def test_a_state_of_another_chain_is_refused(name: str, value: object, tmp_path: Path) -> None:
    kept: list[State] = []
    whole = record_chain(tmp_path / "run.mcap", deeds={121: lambda tick: kept.append(save_state(tick))})
    state = spoil(kept[0], name, value)
    notes = {
        LAYOUT_NOTE: {"arrays": describe_arrays(state)}, STATE_NOTE: {"tick": "120", "arrays": pack_arrays(state)},
    }  # fmt: skip
    with pytest.raises(RecordingError, match="does not fit"):
        Replay(late(whole, tmp_path / "late.mcap", 120, notes))


def test_any_numbers_in_a_state_end_in_a_replay_or_a_message(tmp_path: Path) -> None:
    kept: list[State] = []
    whole = record_chain(tmp_path / "run.mcap", deeds={121: lambda tick: kept.append(save_state(tick))}, ticks=140)
    random = np.random.default_rng(35)
    values = np.array([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e300, -(2.0**63), 2.0**62, 5e-324])
    whole_numbers = np.array([0, 1, -1, 2**62, -(2**62), 511, 513])
    for number in range(40):
        state = {name: one.copy() for name, one in kept[0].items()}
        for array in state.values():
            if random.random() < 0.3 and array.size:
                chosen = values if array.dtype.kind == "f" else whole_numbers
                array.flat[random.integers(array.size)] = random.choice(chosen)
        notes = {
            LAYOUT_NOTE: {"arrays": describe_arrays(state)}, STATE_NOTE: {"tick": "120", "arrays": pack_arrays(state)},
        }  # fmt: skip
        with suppress(HaptorbError), np.errstate(all="ignore"):
            Replay(late(whole, tmp_path / f"late{number}.mcap", 120, notes)).run()


@pytest.mark.parametrize(("name", "near"), [("omni_pickled_states.mcap", False), ("omni_pickled_trip.mcap", True)])
def test_pickled_states_of_an_older_version_are_not_read(name: str, near: bool) -> None:
    replay = Replay(Recording(OLDER / name))
    found = replay.run()
    assert found.compared == (50 if near else 90)
    assert replay.approximate == near
    (remark,) = replay.remarks
    assert "older version" in remark


class Harm:
    """What makes a folder when it is unpickled."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[object, ...]:
        return Path.mkdir, (self.folder,)


def test_a_pickled_state_runs_no_code(tmp_path: Path) -> None:
    whole = record_chain(tmp_path / "run.mcap", ticks=130)
    text = b64encode(zlib.compress(pickle.dumps(Harm(tmp_path / "made")))).decode()
    older = late(whole, tmp_path / "late.mcap", 120, {STATE_NOTE: {"tick": "120", "state": text}})
    assert any("older version" in remark for remark in Replay(older).remarks)
    newer = {LAYOUT_NOTE: {"arrays": '[["a", "|b1", [8]]]'}, STATE_NOTE: {"tick": "120", "arrays": text}}
    with pytest.raises(RecordingError, match="state"):
        Replay(late(whole, tmp_path / "newer.mcap", 120, newer))
    assert not (tmp_path / "made").exists()


def test_a_file_is_not_replaced_by_accident(tmp_path: Path) -> None:
    (tmp_path / "there.mcap").touch()
    with pytest.raises(RecordingError, match="exists"):
        check_replay_file(tmp_path / "there.mcap", overwrite=False)
    with pytest.raises(RecordingError, match="folder"):
        check_replay_file(tmp_path / "no" / "there.mcap", overwrite=False)
    os.mkfifo(tmp_path / "pipe")
    replay = Replay(record_chain(tmp_path / "run.mcap", ticks=20))
    with pytest.raises(RecordingError, match="not a regular file"), replay.write_to(tmp_path / "pipe"):
        pass


@pytest.mark.parametrize("planted", [None, pytest.param(60, marks=pytest.mark.slow), 222])
def test_parts_at_once_find_what_one_after_the_other_does(
    planted: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept: list[State] = []
    deeds: dict[int, Deed] = {
        101: lambda tick: kept.append(save_state(tick)),
        130: lambda tick: tick.change_world(RollingBall()),
        151: lambda tick: kept.append(save_state(tick)),
    }

    def change(rows: Array) -> None:
        if planted is not None:
            rows[planted, RowLayout.of(load("omni"))["duty_commanded"].stop - 1] += 1.0

    whole = record_chain(tmp_path / "run.mcap", deeds=deeds, change=change)
    path = tmp_path / "kept.mcap"
    with path.open("wb") as file:
        recorder = Recorder(file, whole.layout, 1000.0, 0)
        for name, values in whole.notes:
            if (short := name.removeprefix("haptorb/")) not in ("layout", "clock"):
                recorder.add_metadata(short, values)
        for tick, state in zip((100, 150), kept, strict=True):
            note_state(recorder, tick, state)
        recorder.append(whole.rows)
        recorder.finish()
    monkeypatch.setattr("haptorb.replay.parallel._MIN_TICKS", 100)
    monkeypatch.setattr("haptorb.recording.recording._MAX_WHOLE_BYTES", 0)  # rows are unpacked beside
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 1, 2})
    at_once, after = replay_in_parts(Recording(path)).comparison, Replay(whole).run()
    assert (at_once.compared, at_once.differing, at_once.numbers) == (300, after.differing, after.numbers)
    assert at_once.first == after.first
    assert (after.first is None) == (planted is None)
    assert at_once.bounds == after.bounds
