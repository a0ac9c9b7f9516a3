"""Server of the chooser: starts one design after another with coils off; no browser, no servo."""

import json
import threading
import time
import urllib.request
from urllib.error import HTTPError

import pytest

from haptorb.errors import InputError, ServoError
from haptorb.web.server import HOST
from haptorb_design import chooser as chooser_module
from haptorb_design.chooser import BASE, Chooser, Selection
from haptorb_design.results_table import ResultsTable
from haptorb_design.store import Results, Run
from oracles.designs.made_designs import make_design, make_evaluations


class _Servo:
    """A servo that only counts its stops, and whether it is open."""

    def __init__(self, device, record):
        if device.name == "omni-core-3":
            raise InputError("no such thing")
        self.device, self.stops, self.open, self.dead = device, 0, False, False
        _Servo.made.append(self)

    def __enter__(self):
        assert self.stops == 1, "a device starts stopped"
        self.open = True
        return self

    def __exit__(self, *error):
        self.open = False

    def stop(self):
        self.stops += 1

    def end_loop(self):
        pass

    def check_end(self):
        if self.dead:
            raise ServoError("the loop ended")


class _Console:
    """A console that serves until it is told."""

    def __init__(self, servo, port, framed_by, where):
        self.servo, self.framed_by = servo, framed_by
        self.url = f"http://{HOST}:1/#{servo.device.name}"

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def serve(self, until):
        while not until() and not self.servo.dead:
            time.sleep(0.01)


@pytest.fixture(scope="module")
def table():
    run = Run(1, "sobol", 1, {}, "0.1.0", "", tuple(make_evaluations(60)))
    return ResultsTable.of(Results(make_design(), (run,)))


@pytest.fixture
def served(table, monkeypatch):
    """A chooser that answers."""
    _Servo.made = []
    monkeypatch.setattr(chooser_module, "Servo", _Servo)
    monkeypatch.setattr(chooser_module, "Console", _Console)
    with Chooser(table, 0) as chooser:
        serving = threading.Thread(target=chooser.serve)
        serving.start()
        _wait(lambda: chooser._server.started)
        yield chooser
        chooser.close()
        serving.join(10)
        assert not any(servo.open for servo in _Servo.made)


def _wait(true, seconds=10.0):
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def _ask(chooser, path, body=None, token=None, **headers):
    shown = {"authorization": f"Bearer {chooser.token if token is None else token}"} | headers
    data = None if body is None else (body if isinstance(body, bytes) else json.dumps(body).encode())
    try:
        with urllib.request.urlopen(urllib.request.Request(chooser.origin + path, data, shown), timeout=10) as answer:
            return answer.status, answer.read(), answer.headers
    except HTTPError as mistake:
        return mistake.code, mistake.read(), mistake.headers


def _now(chooser):
    return json.loads(_ask(chooser, "/api/now")[1])


def test_only_who_knows_the_token_comes_in_and_the_page_frames_this_computer_only(served):
    status, _, headers = _ask(served, "/", token="no")
    assert status == 200
    assert f"frame-src http://{HOST}:*" in headers["content-security-policy"]
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    for path, body in (("/api/designs", None), ("/api/now", None), ("/api/choose", {"row": 0}), ("/api/stop", {})):
        assert _ask(served, path, body, token="wrong-token-0123456")[0] == 403
        assert _ask(served, path, body, origin="http://evil.example")[0] == 403
    assert len(json.loads(_ask(served, "/api/designs")[1])["names"]) == len(served._table.found)
    assert _Servo.made == []


BAD = [b"", b"[1]", b"{", {"row": 1e3}, {"row": "0"}, {"row": -2}, {"row": True}, {}, b"x" * 2000]


@pytest.mark.parametrize("body", BAD)
def test_a_choice_that_is_none_is_refused(served, body):
    status, text, _ = _ask(served, "/api/choose", body)
    assert status == 409
    assert text.strip()
    assert _now(served)["state"] == "none"


def test_one_design_after_another_runs_with_its_coils_off(served):
    row = served._table.picks[0].row
    for wanted, name in ((row, served._table.name(row)), (BASE, "omni")):
        assert _ask(served, "/api/choose", {"row": wanted})[0] == 200
        _wait(lambda: _now(served)["state"] == "running")
        assert _Servo.made[-1].device.name == name
        assert _Servo.made[-1].stops == 1  # nobody has engaged it
        assert _now(served)["url"].endswith(name)
        assert [servo.open for servo in _Servo.made].count(True) == 1
    assert _Servo.made[0].stops == 2  # off at the choice, before the next one starts
    assert _now(served)["base"]
    _ask(served, "/api/stop", {})
    assert _Servo.made[-1].stops == 2


def test_a_device_that_cannot_run_or_ends_is_told_and_another_can_be_chosen(served):
    names = [served._table.name(row) for row in range(len(served._table.found))]
    row = names.index("omni-core-3")
    _ask(served, "/api/choose", {"row": row})
    _wait(lambda: _now(served)["state"] == "refused")
    assert "omni-core-3 does not run: no such thing" in _now(served)["text"]
    _ask(served, "/api/choose", {"row": BASE})
    _wait(lambda: _now(served)["state"] == "running")
    _Servo.made[-1].dead = True
    _wait(lambda: _now(served)["state"] == "refused")
    assert "the loop ended" in _now(served)["text"]


def test_while_one_starts_no_other_can_be_chosen():
    selection = Selection(3)
    assert selection.wait(0.0) is None
    selection.choose(2)
    assert selection.pending
    with pytest.raises(InputError, match="another design is starting"):
        selection.choose(1)
    assert selection.wait(0.0) == 2
    assert not selection.pending
    selection.set_refused("why")
    selection.choose(1)
    assert selection.wait(0.0) == 1
