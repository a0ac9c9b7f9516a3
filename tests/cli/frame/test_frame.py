"""`haptorb frame`: from OSC messages to a file that `run` accepts, with all failures on the way."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import ExitStack, nullcontext, suppress
from pathlib import Path

import pytest

from haptorb.cli import main
from haptorb.cli.frame_dialog import Rehearsal, Stroke, measure_miss, register_frame, rehearsal_port, strokes
from haptorb.devices.loader import load
from haptorb.errors import CalibrationError, DriverError, InputError
from haptorb.estimation.calibration_file import read_frame
from haptorb.runtime.trackers.base import Feed, RawPose, RejectedPose
from haptorb.runtime.trackers.registry import feed_of, prepare_tracker

pytestmark = pytest.mark.realtime

OMNI = load("omni")


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def no_bar(title: str, seconds: float) -> object:
    return nullcontext(lambda passed: None)


class PlaybackFeed(Feed):
    """What one step's person would do, at once; what waited before is an old pose."""

    def __init__(self, rehearsal: Rehearsal, spoil: object = None) -> None:
        self._rehearsal, self._spoil = rehearsal, spoil
        self.waiting: list[RawPose | RejectedPose] = [RawPose((9.0, 9.0, 9.0), (0.0, 0.0, 0.0, 1.0), 0.0, 0.0)]

    def do(self, stroke: Stroke) -> bool:
        self._stroke = stroke
        return True

    def receive(self, timeout: float) -> Iterator[RawPose | RejectedPose]:
        if timeout > 0.0 and self._stroke is not None:  # the step has begun
            person, name = self._rehearsal._person, self._stroke.name
            poses = person.dome(300) if name == "dome" else (
                person.roll(80) if name == "roll" else person.mark(name.partition(" ")[2], 80))  # fmt: skip
            self._stroke = None
            for p, q in zip(poses.p.tolist(), poses.q.tolist(), strict=True):
                one: RawPose | RejectedPose = RawPose(tuple(p), tuple(q), 0.0, 0.0)
                self.waiting.append(self._spoil(one) if callable(self._spoil) else one)
        while self.waiting:
            yield self.waiting.pop(0)

    def close(self) -> None:
        return


def test_a_rehearsal_runs_through_sockets_and_its_file_is_taken_by_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("haptorb.cli.frame_dialog.TIME_SCALE", 0.04)
    port = free_port()
    with suppress(SystemExit):
        assert main(["frame", "omni", "--rehearse", "--tracker", f"osc:{port}", "--json"]) == 0
    told = capsys.readouterr()
    frame = read_frame("omni.frame.json")
    assert json.loads(told.out)["digest"] == OMNI.digest
    assert "5/5 roll" in told.err
    assert (frame.tracker, frame.simulated, frame.device) == (f"osc:{port}", True, "omni")
    assert frame.residual < 0.3e-3
    rehearsal = Rehearsal(OMNI, port, 0)
    place, angle = measure_miss(frame, rehearsal.tracker, OMNI)
    assert place < 0.3e-3
    assert angle < 0.01
    assert main(["frame", "omni", "--rehearse"]) == 2  # never over another by accident
    assert "--force" in capsys.readouterr().err
    assert main(["run", "omni", "--headless", "--tracker", "osc:1", "--frame", "omni.frame.json"]) == 2
    assert f"to tracker 'osc:{port}', not" in capsys.readouterr().err


def test_what_waited_before_a_step_is_none_of_its_poses() -> None:
    played = PlaybackFeed(Rehearsal(OMNI, 0, 3))
    said: list[str] = []
    found = register_frame(OMNI, played, prompt=played.do, notify=said.append, bar=no_bar, pace=0.001)  # type: ignore[arg-type]
    assert found is not None
    place, angle = measure_miss(found, played._rehearsal.tracker, OMNI)
    assert place < 0.3e-3
    assert angle < 0.01
    assert [line[:3] for line in said if "/5" in line] == ["1/5", "2/5", "3/5", "4/5", "5/5"]


@pytest.mark.parametrize(
    ("spoil", "error", "told"),
    [
        (lambda one: one._replace(valid=False), DriverError, "no pose arrived from the tracker .*300 lost"),
        (lambda one: RejectedPose("stranger"), DriverError, "300 stranger"),
        (lambda one: one._replace(p=(float("nan"), 0.0, 0.0)), DriverError, "300 not finite"),
        (lambda one: one._replace(p=one.p[:2]), DriverError, "300 garbage"),
        (lambda one: one if hash(one.p) % 3 == 0 else RejectedPose("garbage"), CalibrationError, "had no valid pose"),
        (lambda one: one._replace(q=(10.0, 20.0, 30.0, 0.0)), CalibrationError, "step 'dome': .*must have length 1"),
        (lambda one: one._replace(p=(0.0, 0.0, 0.0), q=(0.0, 0.0, 0.0, 1.0)), CalibrationError, "only 1 distinct pose"),
        (lambda one: one._replace(p=tuple(1e3 * x for x in one.p)), CalibrationError, "millimetres"),
    ],
)  # fmt: skip
def test_what_cannot_be_a_session_is_refused(spoil: object, error: type[Exception], told: str) -> None:
    played = PlaybackFeed(Rehearsal(OMNI, 0, 3), spoil)
    with pytest.raises(error, match=told):
        register_frame(OMNI, played, prompt=played.do, notify=print, bar=no_bar, pace=0.001)  # type: ignore[arg-type]


def test_a_person_may_stop() -> None:
    played = PlaybackFeed(Rehearsal(OMNI, 0, 3))
    asked: list[str] = []

    def ask(stroke: Stroke) -> bool:
        asked.append(stroke.name)
        return played.do(stroke) and stroke.name != "mark front"

    assert register_frame(OMNI, played, prompt=ask, notify=print, bar=no_bar, pace=0.001) is None  # type: ignore[arg-type]
    assert asked == ["dome", "mark front"]


def test_the_steps_are_the_devices_marks() -> None:
    assert [one.name for one in strokes(OMNI)] == ["dome", "mark front", "mark left", "mark rear", "roll"]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["pmsm", "--rehearse"], "works for spherical electromagnets"),
        (["omni", "--tracker", "pointer"], "already reports poses in the stator's frame"),
        (["omni", "--tracker", "replay:run.mcap"], "already reports poses in the stator's frame"),
        (["omni", "--tracker", "osk:9000"], "unknown tracker"),
        (["omni", "--rehearse", "--tracker", "lsl:pen"], "OSC"),
        (["omni", "--rehearse", "--out", "nowhere/omni.json"], "folder 'nowhere' does not exist"),
        (["omni"], "there is no terminal"),
    ],
)
def test_a_mistake_is_one_line(
    arguments: list[str], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["frame", *arguments]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert "Traceback" not in said
    assert list(tmp_path.iterdir()) == []


def test_nobody_sends() -> None:
    preparation = prepare_tracker(f"osc:{free_port()}")
    with ExitStack() as opened:
        feed = feed_of(preparation.spec, preparation.descriptor, lambda: 0.0)
        opened.callback(feed.close)
        with pytest.raises(DriverError, match=r"step 'dome': no pose arrived from the tracker \(nothing at all\)"):
            register_frame(OMNI, feed, prompt=lambda stroke: True, notify=print, bar=no_bar, pace=0.003)  # type: ignore[arg-type]


def test_a_rehearsal_is_on_this_computer() -> None:
    assert rehearsal_port("osc:9000") == 9000
    with pytest.raises(InputError, match="OSC on this computer"):
        rehearsal_port("osc:192.168.1.2:9000")
