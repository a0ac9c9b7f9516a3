"""Time to set three coils and read them back through the emulated firmware, and capacity of the bus.

    python benchmarks/serial_cycle.py [--pace 0.1] [--cycles 2000] [--board m328p] [--json]

Beside what is measured it says what the line alone takes: bytes of a frame each way, ten bits a byte at 1 Mbaud.

At pace 1 the round trip is measured on this computer's clock, with this computer's delays. At a lower pace firmware
time runs slower than ours and only the firmware's own times mean anything: the turn (first bit of the frame to last
bit of the answer), the rounds of the I²C bus, lost bytes.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from haptorb.runtime.drivers.emulator_process import Emulator
from haptorb.runtime.drivers.serial import BAUD, Board
from haptorb.runtime.drivers.serial_protocol import READING, READING_BYTES, BoardMode, Frame, encode, set_duties

BUILD = Path(__file__).resolve().parents[1] / "firmware" / "build"


def processor_time(number: int) -> float:
    """Processor time that the process `number` has taken [s]."""
    fields = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(board: str, pace: float, cycles: int) -> dict[str, float]:
    """Numbers of one run: a frame every millisecond of firmware time, signs changing every 20 ms."""
    with tempfile.TemporaryDirectory() as folder, Emulator(BUILD, Path(folder, "port"), board) as emulator:
        device = Board(emulator.port, answer=2.0)
        time.sleep(0.3)
        emulator.execute(f"pace {pace}")
        device.engage(0.5, 20.0)
        before = device.set([100, 100, 100]).rounds
        steps = np.array([0, 400, -200])
        emulator.status()
        start = float(emulator.status()["t"])
        trips = rounds = 0
        cpu, wall, emulating = time.process_time(), time.perf_counter(), processor_time(emulator.pid)
        deadline = wall
        for k in range(cycles):  # as the driver does: collect the answer to the last frame, send the next
            deadline = max(deadline + 1e-3 / pace, time.perf_counter() - 1e-3 / pace)
            time.sleep(max(0.0, deadline - time.perf_counter()))
            reading = device.collect(1.0)
            steps[0] = (800 if k % 40 < 20 else -800) + k % 7
            device.post(steps)
            if reading is None:
                continue
            now = int(reading["rounds"][0])
            rounds += (now - before) & 0xFF
            before = now
            if reading["mode"][0] != BoardMode.ENGAGED:
                trips += 1
                device.collect(1.0)
                device.switch_off()
                device.engage(0.5, 20.0)
                before = device.set([100, 100, 100]).rounds
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        emulating = processor_time(emulator.pid) - emulating
        words = emulator.status()
        device.collect(1.0)
        took = np.empty(300)
        for k in range(len(took)):
            began = time.perf_counter()
            device.set([k, 0, 0])
            took[k] = time.perf_counter() - began
        device.close()
        elapsed = float(words["t"]) - start
        asked = len(encode(set_duties(0, [0, 0, 0])))
        answered = len(encode(Frame(READING, 0, bytes(READING_BYTES))))
        return {
            "cycles per second of firmware time": cycles / elapsed,
            "bytes of a SET": asked,
            "bytes of its answer (3 currents, 4-5 Hall sensors, 1 thermometer)": answered,
            "line time of both [ms]": 1e3 * 10 * (asked + answered) / BAUD,
            "turn, median [ms]": float(words["turn_us"]) / 1e3,
            "turn, 99 % [ms]": float(words["turn_p99_us"]) / 1e3,
            "bus rounds per second (3 currents, 4-5 Hall sensors each)": rounds / elapsed,
            "bus load": float(words["bus_load"]),
            "bytes lost by the firmware": float(words["overruns"]),
            "trips": trips,
            "round trip on this computer, median [ms]": 1e3 * float(np.median(took)),
            "round trip on this computer, 99 % [ms]": 1e3 * float(np.percentile(took, 99)),
            "host CPU [%]": 100 * cpu / wall,
            "emulator's CPU for a second of firmware time [s]": emulating / elapsed,
        }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pace", type=float, default=1.0)
    parser.add_argument("--cycles", type=int, default=2000)
    parser.add_argument("--board", default="m328p")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    result = measure(given.board, given.pace, given.cycles)
    if given.json:
        print(json.dumps(result))
        return
    for name, value in result.items():
        print(f"{name:66s} {value:10.3f}")


if __name__ == "__main__":
    main()
