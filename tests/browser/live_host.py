"""A servo and its console in a process of their own, as in `haptorb run`; answers queries on stdin.

The test's own process drives a browser, and would starve a servo's heartbeat on a busy machine.
"""

from __future__ import annotations

import json
import sys
import threading
from dataclasses import replace
from typing import Any

from haptorb.devices.loader import load
from haptorb.runtime.servo import Servo
from haptorb.web.console import Console
from haptorb.worlds import Dome
from haptorb.worlds.base import values


def main() -> None:
    omni = load("omni")
    # Poses last a second instead of 50 ms: an overloaded test machine stutters, and is not what is tested here.
    servo = Servo(replace(omni, limits=replace(omni.limits, expiry=1.0)), "dome", record=False)
    ended, ended_by_test = threading.Event(), threading.Event()

    def answer(question: dict[str, Any]) -> Any:
        match question["what"]:
            case "latest":
                return servo.latest().numbers.tolist()
            case "rows":
                cursor, rows = servo.rows(question["cursor"])
                return [cursor, rows[:, question["columns"]].tolist()]
            case "world":
                return servo.world
            case "restore":
                servo.set_world("dome", values(Dome()))
                servo.set_model(servo.models[0])
                return servo.engage(servo.stops)
            case "trips":
                return servo.report()["trips"]
            case "end servo":
                ended_by_test.set()
                return servo.close()
            case "end console":
                return ended.set()
        raise ValueError(question)

    def listen() -> None:
        for line in sys.stdin:
            print(json.dumps(answer(json.loads(line))), flush=True)
        ended.set()

    with Console(servo, 0) as console, servo:
        print(json.dumps(console.url), flush=True)
        threading.Thread(target=listen, daemon=True).start()
        console.serve(until=ended.is_set)
        if not servo.alive and not ended_by_test.is_set():
            servo.check()  # its own reason


if __name__ == "__main__":
    main()
