"""Minimal host to be killed: `minimal_host.py PORT` engages and sets duties until it dies."""

from __future__ import annotations

import os
import select
import struct
import sys
import tty
from binascii import crc_hqx


def main() -> None:
    port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
    tty.setraw(port)
    sequence = 0

    def ask(kind: int, payload: bytes = b"") -> bytes:
        nonlocal sequence
        sequence = (sequence + 1) & 0xFF
        body = bytes((len(payload), kind, sequence)) + payload
        os.write(port, b"\xa5\x5a" + body + struct.pack("<H", crc_hqx(body, 0xFFFF)))
        answer = b""
        while not (len(answer) > 4 and len(answer) >= 7 + answer[2]):
            if not select.select((port,), (), (), 2.0)[0]:
                sys.exit("no answer")
            heard = os.read(port, 256)
            if not heard:
                sys.exit("the line was closed")  # else nobody would ever end this program
            answer += heard
        return answer[5:-2]

    ask(0x05)
    while ask(0x04, struct.pack("<3H", 0x5AFE, 4095, 20000))[4] != 0:
        pass
    print("engaged", flush=True)
    while True:
        if ask(0x03, struct.pack("<3h", 800, -400, 200))[0] != 1:
            print("tripped", flush=True)
            sys.exit(1)


if __name__ == "__main__":
    main()
