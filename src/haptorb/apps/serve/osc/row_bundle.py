"""A row as an OSC bundle: the messages of `addresses.OUTGOING`, stamped with the time at which the tick began."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import final

import numpy as np

from haptorb.apps.serve.osc.addresses import OUTGOING, Outgoing
from haptorb.numerics.arrays import Array
from haptorb.runtime.exchange.commands import BUTTONS
from haptorb.runtime.row import RowLayout

__all__ = ["RowBundle", "pad_text"]

_SINCE_1900 = 2_208_988_800  #: seconds from the epoch of OSC's time tags to that of Unix
_FRACTIONS = 1 << 32  #: of a second, in a time tag
_INTEGERS = 1 << 31


@final
class RowBundle:
    """Packs rows of `layout`; `utc` leads from their clock `wall` to seconds since 1970 [s].

    Every bundle has the same form, so the form is made once and a bundle is one call of `struct.pack`.
    """

    def __init__(self, layout: RowLayout, utc: float, messages: Sequence[Outgoing] = OUTGOING) -> None:
        self._utc = utc
        self._wall = layout["wall"].start
        formats, self._parts = [], list[bytes | int | None]()
        places, whole = list[int](), list[bool]()
        for message in messages:
            indices = _find_numbers(layout, message)
            kind = "i" if message.whole else "f"
            head = pad_text(message.address) + pad_text("," + kind * len(indices))
            formats.append(f"i{len(head)}s{kind * len(indices)}")
            self._parts += [len(head) + 4 * len(indices), head, *[None] * len(indices)]
            places += indices
            whole += [message.whole] * len(indices)
        self._form = struct.Struct(">8sII" + "".join(formats))
        self._places = np.array(places)
        self._whole = whole
        self._gaps = [i for i, part in enumerate(self._parts) if part is None]

    def pack(self, row: Array, buttons: Sequence[bool] = (False,) * len(BUTTONS)) -> bytes:
        """The bundle of `row` (width,), in the units of its layout, with the `buttons` that are held down. A count or
        code that is not known is −1."""
        filled: list[object] = list(self._parts)
        numbers = np.concatenate([row, buttons])[self._places].tolist()
        for gap, number, whole in zip(self._gaps, numbers, self._whole, strict=True):
            filled[gap] = _to_integer(number) if whole else _to_single(number)
        moment = row[self._wall] + self._utc + _SINCE_1900
        seconds = int(moment // 1)
        return self._form.pack(b"#bundle\x00", seconds % _FRACTIONS, int((moment - seconds) * _FRACTIONS), *filled)


def _find_numbers(layout: RowLayout, message: Outgoing) -> range:
    """Where the numbers of `message` lie in a row, behind which the buttons stand."""
    if message.field == "buttons":
        return range(layout.width, layout.width + len(BUTTONS))
    field = layout[message.field]
    return range(field.start, field.stop)[message.first : message.last]


def _to_integer(number: float) -> int:
    return int(number) % _INTEGERS if number == number and number >= 0.0 else -1


def _to_single(number: float) -> float:
    return number if abs(number) < 3e38 else float("nan")  # what a float32 cannot hold is no number


def pad_text(text: str) -> bytes:
    """`text` as OSC has it: ended by one to four zeros, so that its length is a multiple of 4 bytes.

    >>> pad_text("/abc"), pad_text(",ff")
    (b'/abc\\x00\\x00\\x00\\x00', b',ff\\x00')
    """
    data = text.encode("utf-8", "replace")
    return data + bytes(4 - len(data) % 4)
