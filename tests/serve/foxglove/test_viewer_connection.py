"""A viewer receives its subscriptions; a slow one loses the oldest, which are counted; invalid input is ignored."""

from __future__ import annotations

import asyncio
import json
import struct

import pytest

from haptorb.serve.foxglove import DESKTOP, MAX_QUEUED_MESSAGES, PAGES, ViewerConnection, prepare
from haptorb.web.access import Access


def subscribe(number: object, topic: object) -> str:
    return json.dumps({"op": "subscribe", "subscriptions": [{"id": number, "channelId": topic}]})


def take_all(viewer: ViewerConnection, count: int) -> list[bytes]:
    async def take() -> list[bytes]:
        return [await viewer.dequeue() for _ in range(count)]

    return asyncio.run(take())


def test_messages_of_a_subscription_come_in_order_with_its_number() -> None:
    viewer = ViewerConnection("test", 1, topics=3)
    viewer.enqueue(2, b"before", 1)
    assert viewer.handle_message(subscribe(17, 2)) == [2]
    viewer.enqueue(2, b"one", 5)
    viewer.enqueue(1, b"other", 6)
    viewer.enqueue(2, b"two", 7)
    found = [(struct.unpack("<BIQ", data[:13]), data[13:]) for data in take_all(viewer, 2)]
    assert found == [((1, 17, 5), b"one"), ((1, 17, 7), b"two")]
    viewer.handle_message(json.dumps({"op": "unsubscribe", "subscriptionIds": [17]}))
    assert not viewer.is_subscribed(2)


def test_a_slow_viewer_loses_the_oldest_and_it_is_counted() -> None:
    viewer = ViewerConnection("test", 1, topics=1)
    viewer.handle_message(subscribe(1, 1))
    for i in range(MAX_QUEUED_MESSAGES + 30):
        viewer.enqueue(1, str(i).encode(), i)
    assert viewer.dropped == 30
    assert take_all(viewer, 1)[0].endswith(b"30")


@pytest.mark.parametrize(
    "text",
    [
        "", "{", "[]", "7", "null", '{"op": 3}', '{"op": "subscribe"}',
        '{"op": "subscribe", "subscriptions": [1, null]}', subscribe(1, 99), subscribe(-1, 1), subscribe(1.5, 1),
        subscribe(True, 1), subscribe(2**40, 1), subscribe([], {}),
        '{"op": "unsubscribe", "subscriptionIds": [[], {}, "a"]}', "[" * 50_000, b"\xff\xfe",
    ],
)  # fmt: skip
def test_nonsense_does_nothing(text: str | bytes) -> None:
    viewer = ViewerConnection("test", 1, topics=1)
    assert viewer.handle_message(text) == []
    assert not viewer.is_subscribed(1)


def test_a_viewer_subscribes_to_so_much_only() -> None:
    viewer = ViewerConnection("test", 1, topics=1)
    for number in range(1000):
        viewer.handle_message(subscribe(number, 1))
    viewer.enqueue(1, b"", 0)
    assert viewer.dropped == 0


@pytest.mark.parametrize(
    ("origin", "host", "trusted"),
    [
        (None, "127.0.0.1:8766", True),
        ("https://app.foxglove.dev", "localhost:8766", True),
        ("http://localhost:8080", "localhost:8766", True),
        ("https://foxglove.dev.example.org", "localhost:8766", False),
        ("https://notfoxglove.dev", "localhost:8766", False),
        ("null", "localhost:8766", False),
        ("file://", "localhost:8766", False),
        ("file://localhost", "localhost:8766", False),
        ("", "localhost:8766", False),
        ("http://localhost.example.org", "localhost:8766", False),
        (None, "example.org:8766", False),
        (None, None, False),
    ],
)
def test_pages_of_other_sites_may_not_look_on(origin: str | None, host: str | None, trusted: bool) -> None:
    headers = {name: value for name, value in (("origin", origin), ("host", host)) if value is not None}
    access = Access("a-token-of-this-run", PAGES, DESKTOP)
    assert (access.refuse("127.0.0.1", headers, "/", own=True) == "") is trusted


@pytest.mark.parametrize(
    ("origin", "target", "trusted"),
    [
        ("file://", "/?token=a-token-of-this-run", True),
        ("file://", "/?token=another", False),
        ("null", "/?token=a-token-of-this-run", False),
        ("https://example.org", "/?token=a-token-of-this-run", False),
    ],
)
def test_a_page_from_a_file_may_look_on_with_the_token(origin: str, target: str, trusted: bool) -> None:
    headers = {"origin": origin, "host": "localhost:8766"}
    access = Access("a-token-of-this-run", PAGES, DESKTOP)
    assert (access.refuse("127.0.0.1", headers, target, own=True) == "") is trusted


def test_the_desktop_program_is_told_its_address(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HAPTORB_SERVE_TOKEN", raising=False)
    prepared = prepare("0")
    prepared.close()
    assert len(prepared.spec["token"]) >= 16
    assert f"{prepared.address}/?token={prepared.spec['token']}" in prepared.remarks[0]
