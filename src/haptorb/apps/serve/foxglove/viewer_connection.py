"""One program that looks on: what it subscribed to, and the messages that wait for it."""

from __future__ import annotations

import asyncio
import json
import struct
from collections import deque
from typing import Any, TypeGuard, final

__all__ = ["ROOM", "ViewerConnection"]

ROOM = 256  #: messages that wait for a viewer; of more, the oldest are dropped and counted
_SUBSCRIPTIONS = 64  #: of one viewer
_HEAD = struct.Struct("<BIQ")  #: operation 1 (message data), subscription, time [ns]


@final
class ViewerConnection:
    """Holds the messages for one connection; its `name` is for people."""

    def __init__(self, name: str, session: int, topics: int) -> None:
        self.name, self.session = name, session
        self._topics = topics
        self._subscriptions: dict[int, int] = {}  # of the viewer: its number → topic
        self._waiting: deque[bytes] = deque()
        self._arrival = asyncio.Event()
        self.sent = 0  #: messages that were given to its connection
        self.dropped = 0  #: messages that it was too slow for

    def is_subscribed(self, topic: int) -> bool:
        """Whether it subscribed to the topic with this number."""
        return topic in self._subscriptions.values()

    def offer(self, topic: int, data: bytes, stamp: int) -> None:
        """The message `data` of a topic, of the time `stamp` [ns since 1970 UTC], once for each of its
        subscriptions."""
        for number, wanted in self._subscriptions.items():
            if wanted == topic:
                if len(self._waiting) >= ROOM:
                    self._waiting.popleft()
                    self.dropped += 1
                self._waiting.append(_HEAD.pack(1, number, stamp) + data)
                self._arrival.set()

    async def take(self) -> bytes:
        """The oldest message, when there is one."""
        while not self._waiting:
            self._arrival.clear()
            await self._arrival.wait()
        self.sent += 1
        return self._waiting.popleft()

    def take_message(self, text: str | bytes) -> list[int]:
        """Do what the viewer's program asks; returns the topics that are new to it. What is none of the protocol's
        subscriptions is passed over: a viewer may ask for more than a server has."""
        try:
            message = json.loads(text)
        except (ValueError, RecursionError):
            return []
        if not isinstance(message, dict):
            return []
        match message.get("op"):
            case "subscribe":
                return [topic for one in _list(message.get("subscriptions")) for topic in self._subscribe(one)]
            case "unsubscribe":
                for number in _list(message.get("subscriptionIds")):
                    if isinstance(number, int):
                        self._subscriptions.pop(number, None)
        return []

    def _subscribe(self, asked: Any) -> list[int]:
        number, topic = (asked.get("id"), asked.get("channelId")) if isinstance(asked, dict) else (None, None)
        if not _is_number(number) or not _is_number(topic):
            return []
        if not 1 <= topic <= self._topics or len(self._subscriptions) >= _SUBSCRIPTIONS:
            return []
        self._subscriptions[number] = topic
        return [topic]


def _list(value: Any) -> list[Any]:
    return value[:_SUBSCRIPTIONS] if isinstance(value, list) else []


def _is_number(value: Any) -> TypeGuard[int]:
    """Whether the protocol can have `value` as the number of a subscription or channel."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 32
