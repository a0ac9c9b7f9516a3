"""Invalid messages to the console, to both pages of a study and to every server.

Every one ends in a sentence or in nothing; no task or thread dies, nobody loses a place, afterwards all still works.
"""

from __future__ import annotations

import importlib.util
import json
import math
import random
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from pythonosc.osc_message_builder import OscMessageBuilder
from websockets.sync.client import connect

from haptorb.errors import InputError
from haptorb.serve.foxglove import ViewerConnection
from haptorb.serve.osc import OscSession
from haptorb.web.console import Console
from haptorb.web.server import command, is_request
from haptorb.worlds import Remote
from serve.published_loop import PublishedLoop

TESTS = Path(__file__).parents[2]
#: (messages, marks): every day a few, at night as many as were promised
AMOUNTS = [1_000, pytest.param(100_000, marks=[pytest.mark.slow, pytest.mark.timeout(3000)])]

SAID = [
    '{"do": "stop"}',
    '{"do": "engage"}',
    '{"do": "home"}',
    '{"do": "mode", "mode": "translate"}',
    '{"do": "clutch", "engaged": true}',
    '{"do": "world", "name": "dome", "values": {"moment": 1.5, "summit": [0, 0.6, 0.8]}}',
    '{"do": "world", "name": "nothing"}',
    '{"do": "begin", "code": "P01"}',
    '{"do": "agree", "agreed": true}',
    '{"do": "answer", "trial": 0, "value": 1}',
    '{"do": "reply", "question": "tired", "reply": "7"}',
    '{"do": "steer", "x": 1.5, "y": -3}',
    '{"do": "draft", "value": 12}',
    '{"do": "interval", "which": 1}',
    '{"do": "skip"}',
    '{"do": "pause", "why": "tea"}',
    '{"do": "resume"}',
    '{"do": "repeat"}',
    '{"do": "leave"}',
]
VALUES = [
    *("null", "true", "[]", "{}", '""', '"stop"', "-0", "0", "1e308", "-1e308", "1e400", "5e-324", "NaN", "-Infinity"),
    *("9" * 19, "9" * 400, "-" + "9" * 5000, "0." + "1" * 5000, "1" * 300 + ".5e-300", "[[[[[[[[1]]]]]]]]"),
    *("[" * 3000, "[" * 900 + "]" * 900, '{"a":' * 500 + "1" + "}" * 500, '"\\ud800"', '"\\udfff\\ud800"', '"\\u0000"'),
    *(
        '"' + "x" * 5000 + '"',
        '"=1+1"',
        '"\U0001f600"',
        "[2.4]",
        '["a"]',
        "[NaN]",
        "[" + "1," * 500 + "1]",
        '{"do": "stop"}',
    ),
]


def messages(seed: int, n: int, valid: Sequence[str] = SAID) -> Iterator[str]:
    """`n` texts: `valid` ones with a value, a letter or a piece replaced, cut or doubled, and plain noise."""
    draw = random.Random(seed)
    for _ in range(n):
        text = draw.choice(valid)
        for _ in range(draw.choice((0, 1, 1, 1, 2, 4))):
            what = draw.random()
            at = draw.randrange(len(text)) if text else 0
            if what < 0.45:
                before, colon, after = text.rpartition(":") if draw.random() < 0.6 else text.partition(":")
                end = min([k for k in (after.find(","), after.find("}")) if k >= 0], default=len(after))
                text = before + colon + draw.choice(VALUES) + after[end:]
            elif what < 0.65:
                text = (
                    text[:at]
                    + chr(draw.choice((0, 9, 34, 44, 91, 92, 123, 125, 233, 0x2028, 0x1F600)))
                    + text[at + 1 :]
                )
            elif what < 0.75:
                text = text[:at]
            elif what < 0.85:
                text += text[: draw.randrange(40)]
            elif what < 0.95:
                text = (
                    text[:at]
                    + f', "{draw.choice(("do", "values", "self", "__class__", ""))}": '
                    + draw.choice(VALUES)
                    + text[at:]
                )
            else:
                text = "".join(chr(draw.randrange(1, 0xD800)) for _ in range(draw.randrange(60)))
        yield text[:60_000]


def pointers(seed: int, n: int) -> Iterator[bytes]:
    """`n` messages of bytes that are, or are nearly, a pointer's."""
    draw = random.Random(seed)
    numbers = (0.0, -0.0, 0.05, 1.0, -1.0, math.nan, math.inf, -math.inf, 1e308, 5e-324, 1e-200, 0.999)
    for _ in range(n):
        data = struct.pack("<9d", *(draw.choice(numbers) for _ in range(9)))
        yield data if draw.random() < 0.9 else draw.randbytes(draw.randrange(200))


@pytest.mark.parametrize("n", AMOUNTS)
def test_every_message_is_read_or_refused_at_once(n):
    longest, read, sentences = 0.0, 0, [""]
    for text in messages(1, n):
        begun = time.process_time()  # a busy computer is not the reader's fault
        try:
            is_request(text, "stop")
            found = command(text)
            json.dumps(found, allow_nan=False, ensure_ascii=False).encode()
            read += 1
        except InputError as refused:
            sentences.append(str(refused))
        longest = max(longest, time.process_time() - begun)
    assert longest < 2.0
    assert max(len(sentence.encode()) for sentence in sentences) < 400
    assert n / 10 < read < 9 * n / 10, "both are tried"


def _module(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@contextmanager
def no_news(capfd: Any, caplog: Any) -> Iterator[None]:
    """Nothing of it is told to whoever reads the terminal."""
    yield
    assert "Traceback" not in capfd.readouterr().err
    assert not [record for record in caplog.records if record.name.startswith(("uvicorn", "asyncio"))]


class Line:
    """A socket on which everything is said, and the answers are looked through for the one to a last question."""

    def __init__(self, socket: Any) -> None:
        self.socket = socket
        self.told: list[dict[str, Any]] = []
        self._hearing = threading.Thread(target=self._hear, daemon=True)
        self._hearing.start()

    def _hear(self) -> None:
        for message in self.socket:
            if isinstance(message, str):
                self.told.append(json.loads(message))

    def say_all(self, said: Iterator[str | bytes], last: str = "no such thing") -> None:
        """Everything, with a question now and then that must be answered: the server is there and has read it all."""
        for k, text in enumerate(said):
            self.socket.send(text)
            if k % 500 == 499:
                self.await_answer(f"{last} {k}")
        self.await_answer(last)

    def await_answer(self, word: str) -> None:
        self.told.clear()
        asked = -math.inf

        def is_answered() -> bool:
            nonlocal asked
            if time.monotonic() - asked > 2.0:  # a newer mistake, of a world that is refused late, takes its place
                asked = time.monotonic()
                self.socket.send(json.dumps({"do": word}))
            return any(told["event"] == "mistake" and word in told["text"] for told in [*self.told])

        self.until(is_answered)

    def until(self, what: Callable[[], object]) -> None:
        end = time.monotonic() + 60
        while not what():
            assert time.monotonic() < end, self.told[-3:]
            assert self._hearing.is_alive(), "the server has closed the socket"
            time.sleep(0.005)


@pytest.mark.parametrize("n", AMOUNTS)
def test_the_console_survives_them(n, capfd, caplog):
    class Servo(_module(TESTS / "web" / "console" / "fake_servo.py").FakeServo):  # type: ignore[misc]
        """Its rows cost nothing: it is not they that are tried."""

        def rows(self, cursor: int = 0, most: int | None = None) -> tuple[int, np.ndarray]:
            return cursor, np.empty((0, self.layout.width))

    servo = Servo()
    with (
        no_news(capfd, caplog),
        Console(servo, 0, force_map=lambda n, v, p: (np.ones(len(p)), np.zeros(len(p), bool))) as console,
    ):
        serving = threading.Thread(target=console.serve)
        serving.start()
        with connect(
            f"ws://127.0.0.1:{console.port}/ws", additional_headers={"Authorization": f"Bearer {console.token}"}
        ) as one:
            line = Line(one)
            line.until(lambda: any(told["event"] == "role" and told["control"] for told in line.told))
            texts, data = messages(2, n), pointers(3, n // 4)
            line.say_all(texts)
            line.say_all(data)
            assert all(np.isfinite(call[1]).all() for call in servo.calls if call[0] == "point")
            stops = servo.count("stop")
            one.send('{"do": "stop"}')
            line.until(lambda: servo.count("stop") > stops)
            line.told.clear()
            one.send('{"do": "world", "name": "wall", "values": {}}')
            line.until(lambda: servo.world[0] == "wall")
            servo.calls.clear()
            one.send('{"do": "engage"}')
            line.until(lambda: servo.count("engage"))
        console.close()
        serving.join(20)
        assert not serving.is_alive()


@pytest.mark.parametrize("n", AMOUNTS)
def test_a_study_survives_them(n, tmp_path, monkeypatch, capfd, caplog):
    pages = _module(TESTS / "study" / "pages" / "test_pages.py")
    monkeypatch.chdir(tmp_path)
    with no_news(capfd, caplog):
        host = pages.StudyHost(pages.study_of(pages.STUDY), tmp_path / "s.db")
        try:
            both = host.experimenter(), host.participant()
            said = [messages(seed, n // 2) for seed in (4, 5)]
            for page in both:
                page.until(lambda page: page.view)
            for part in range(n // 400):  # in turns: what one begins the other may be asked about
                for page, texts in zip(both, said, strict=True):
                    for text in islice(texts, 200):
                        page.socket.send(text)
                    _await_answer(page, f"no such thing {part}")
            for page in both:
                page.close()
            chief = host.experimenter()
            # The server learns that a page has gone after the page does, and a participant's page stops the session.
            chief.until(lambda page: page.view and not page.view["pages"])
            if chief.view["session"]:
                chief.do("leave")
            chief.until(lambda page: not page.view["session"])
            chief.do("begin", code="P77")
            chief.state("consent")
            chief.do("leave")
            chief.until(lambda page: not page.view["session"])
        finally:
            host.close()


def _await_answer(page: Any, word: str) -> None:
    asked = -math.inf

    def is_answered(page: Any) -> bool:
        nonlocal asked
        if time.monotonic() - asked > 2.0:  # of many mistakes at once only some are told
            asked = time.monotonic()
            page.socket.send(json.dumps({"do": word}))
        return any(word in text for text in page.mistakes)

    page.until(is_answered)
    page.mistakes.clear()
    page.heard.clear()


#: what programs for Haply's Inverse Service send
HAPLY = [
    "{}",
    '{"inverse3": [{"device_id": "ID", "commands": {"set_cursor_force": {"vector": {"x": 0.1, "y": 0, "z": 0.5}}}}]}',
    '{"inverse3": [{"device_id": "ID", "commands": {"set_cursor_force": {"values": {"x": 0.1, "y": 0, "z": 0.5}}}}]}',
    '{"inverse3": [{"device_id": "ID", "commands": {"probe_position": {}}}]}',
    '{"inverse3": [{"device_id": "ID", "configure": {"preset": {"preset": "defaults"}, "mount": {}}}]}',
    '{"session": {"force_render_full_state": {}, "configure": {"profile": {"name": "test"}}}}',
]
FOXGLOVE = [
    '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 1}]}',
    '{"op": "unsubscribe", "subscriptionIds": [1]}',
    '{"op": "advertise", "channels": [{"id": 1, "topic": "/x", "encoding": "json", "schemaName": "x"}]}',
    '{"op": "getParameters", "parameterNames": ["a"], "id": "7"}',
    '{"op": "setParameters", "parameters": [{"name": "a", "value": 1}], "id": "7"}',
]


def packets(seed: int, n: int) -> Iterator[bytes]:
    """`n` datagrams: OSC messages with values of any type, bytes changed, cut, or plain noise."""
    draw = random.Random(seed)
    words = ("subscribe", "force", "world", "parameter/limit", "parameters", "unsubscribe", "stop")
    addresses = (*(f"/haptorb/{word}" for word in words), "/", "/x")
    for _ in range(n):
        builder = OscMessageBuilder(draw.choice(addresses))
        for _ in range(draw.randrange(6)):
            builder.add_arg(draw.choice((0.5, -1.0, math.nan, math.inf, 3e38, 7, "dome", "", True, None, b"bytes")))
        data = bytearray(builder.build().dgram)
        for _ in range(draw.choice((0, 0, 1, 3))):
            data[draw.randrange(len(data))] = draw.randrange(256)
        yield bytes(data[: draw.randrange(len(data))] if draw.random() < 0.1 else data)


@pytest.mark.parametrize("n", AMOUNTS)
def test_a_haply_server_answers_each_of_them_once(n, capfd, caplog):
    serve = _module(TESTS / "serve" / "conftest.py")
    bench = serve.Bench()
    try:
        preparation = serve.prepare("0:0")
        port = int(preparation.address.split(",")[0].rpartition(":")[2])
        serving = threading.Thread(
            target=serve.serve, args=(preparation.spec, list(preparation.descriptors), bench.served)
        )
        serving.start()
        with no_news(capfd, caplog), connect(f"ws://127.0.0.1:{port}", compression=None, open_timeout=20) as client:
            first = json.loads(client.recv(timeout=20))
            named = [text.replace("ID", first["inverse3"][0]["device_id"]) for text in HAPLY]
            for text in messages(6, n // 5, named):
                client.send(text.encode("utf-8", "replace").decode()[:20_000])
                answer = json.loads(client.recv(timeout=20))
                assert np.isfinite(list(answer["inverse3"][0]["state"]["cursor_position"].values())).all()
                assert np.isfinite(bench.read_client()["force"]).all()
            client.send("{}")
            assert json.loads(client.recv(timeout=20))["inverse3"]
    finally:
        bench.served.ending = True
        serving.join(20)
        bench.shared.unlink()
    assert not serving.is_alive()


@pytest.mark.parametrize("n", AMOUNTS)
def test_an_osc_server_survives_them(n):
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind(("127.0.0.1", 0))
    with (
        PublishedLoop(Remote()) as loop,
        closing(OscSession(opened, loop.served, "")) as session,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        sender.bind(("127.0.0.1", 0))
        loop.publish()
        for data in packets(7, n):
            sender.sendto(data, opened.getsockname())
            session.read_messages()
            assert np.isfinite(loop.receive()[0]).all()
        builder = OscMessageBuilder("/haptorb/force")
        for value in (0.0, 0.0, 0.25):
            builder.add_arg(value)
        sender.sendto(builder.build().dgram, opened.getsockname())
        session.read_messages()
        assert loop.receive()[0] == [0.0, 0.0, 0.25]


@pytest.mark.parametrize("n", AMOUNTS)
def test_a_foxglove_server_survives_them(n):
    viewer = ViewerConnection("test", 1, topics=3)
    for text in messages(8, n, FOXGLOVE):
        assert all(0 <= topic < 3 for topic in viewer.handle_message(text))
    viewer.handle_message('{"op": "unsubscribe", "subscriptionIds": [17]}')
    assert viewer.handle_message('{"op": "subscribe", "subscriptions": [{"id": 17, "channelId": 2}]}') in ([2], [])
