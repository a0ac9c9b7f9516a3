"""Resets at random times after STORE: loss of an id that the firmware has confirmed.

    python benchmarks/safety/store_resets.py [--resets 100] [--board m328p] [--seed 0]

The real firmware in the emulator is told to keep one id after another. At a random time, from the moment of the first
question to some time after the last byte, it is reset, and the byte of the EEPROM that was being written then is torn:
some of its bits are random. What it says to keep after the restart must be the new id if it had been called kept,
else the new one or the one before. Exit code 1 if it was anything else.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from haptorb.errors import DriverError
from haptorb.runtime.drivers.emulator_process import Emulator
from haptorb.runtime.drivers.serial import Board
from haptorb.runtime.drivers.serial_protocol import Refusal

BUILD = Path(__file__).resolve().parents[2] / "firmware" / "build"
LONGEST = 0.13  #: of firmware time from STORE to the reset [s]; all bytes take 0.075 s
BOOT = 0.05  #: of firmware time until it listens: a question that it misses costs 5 s of patience [s]


@dataclass
class ResetCounts:
    """What the ids were after the resets."""

    resets: int = 0
    intact: int = 0  #: called kept before the reset, and kept
    new: int = 0  #: not called kept yet, and there all the same
    old: int = 0  #: not called kept yet, and the one before is there
    lost: int = 0  #: called kept, and not there
    garbage: int = 0  #: neither the new one nor the one before
    torn: int = 0  #: bytes of the EEPROM that a reset tore


def try_resets(build: Path, port: Path, resets: int, seed: int = 0, board: str = "m328p") -> ResetCounts:
    """Reset the emulated `board` so many times; `port` is where its line will be."""
    chance, found, before = random.Random(seed), ResetCounts(), bytes(16)
    with Emulator(build, port, board) as emulator:
        device = Board(emulator.port, 30.0, answer=5.0)
        try:
            while found.resets < resets:
                wanted = chance.randbytes(16)
                end = float(emulator.status()["t"]) + chance.uniform(0.0, LONGEST)
                called_kept = device.store(wanted).refusal is Refusal.ACCEPTED  # the first answer counts, too
                while float(emulator.status()["t"]) < end:
                    called_kept |= device.store(wanted).refusal is Refusal.ACCEPTED
                emulator.execute("reset")
                emulator.wait(BOOT)
                found.resets += 1
                there = _there(device)
                if called_kept:
                    found.intact += there == wanted
                    found.lost += there != wanted
                else:
                    found.new += there == wanted
                    found.old += there == before
                found.garbage += there not in (wanted, before)
                before = there
            found.torn = int(emulator.status()["torn"])
        finally:
            device.close()
    return found


def _there(device: Board) -> bytes:
    """The id that it keeps; it has just restarted, and the first question may fall on deaf ears."""
    for _ in range(5):
        try:
            return device.identify().calibration
        except DriverError:
            continue
    return device.identify().calibration


def main() -> int:
    """Try, and say what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--resets", type=int, default=100)
    parser.add_argument("--board", choices=("m328p", "m2560"), default="m328p")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    made = subprocess.run(["make", "-C", str(BUILD.parent)], capture_output=True, text=True, check=False)
    if made.returncode:  # an older build would be tried in its place
        sys.exit(f"the firmware cannot be built:\n{made.stdout}{made.stderr}")
    with tempfile.TemporaryDirectory() as folder:
        found = try_resets(BUILD, Path(folder) / "port", given.resets, given.seed, given.board)
    print(
        f"{found.resets} resets, {found.torn} torn bytes: {found.intact + found.lost} after the id was called kept, "
        f"{found.lost} of them lost; before that {found.new} new and {found.old} old ids"
    )
    good = not (found.lost or found.garbage)
    print("never kept and then lost" if good else f"{found.lost} lost, {found.garbage} neither old nor new")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
