"""A bounded text in shared memory with a version: one writer, readers that never see half of it."""

from __future__ import annotations

from typing import final

from haptorb.errors import InputError

__all__ = ["SIZE", "TextSlot"]

SIZE = 16_384  #: bytes of a slot, its two leading words included

_TRIES = 100


@final
class TextSlot:
    """Two words (version, length) and UTF-8. The version is odd while the text is being written."""

    def __init__(self, memory: memoryview) -> None:
        self._words = memory[:16].cast("q")
        self._bytes = memory[16:]
        self.room = len(self._bytes)  #: longest text [bytes]

    @property
    def version(self) -> int:
        """How many texts were written; compares unequal after every `write`."""
        return int(self._words[0]) // 2

    def write(self, text: str) -> int:
        """Replace the text; returns its version. Raises InputError if it is too long."""
        data = text.encode()
        if len(data) > self.room:
            raise InputError(f"a message of {len(data)} bytes is too long: at most {self.room}")
        version = self._words[0] | 1
        self._words[0] = version
        self._words[1] = len(data)
        self._bytes[: len(data)] = data
        self._words[0] = version + 1
        return (version + 1) // 2

    def read(self) -> tuple[int, str]:
        """(version, text); (0, "") before the first, and if a writer ended while it wrote."""
        for _ in range(_TRIES):
            before = self._words[0]
            length = self._words[1]
            if before & 1 or not 0 <= length <= self.room:
                continue
            data = bytes(self._bytes[:length])
            if self._words[0] == before:
                return before // 2, data.decode()
        return 0, ""
