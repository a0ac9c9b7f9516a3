"""Lead the hand round a circle, over WebSocket: a spring between the tool and a point that goes round.

    haptorb run omni --serve haply
    python lead_the_hand.py

One message asks for a force, the answer says where the tool is: the next force follows from it. The force stands for
50 ms, so the loop must go on; when this program ends, the force does, too.
"""

import argparse
import json
import math
import time

from websockets.sync.client import connect

parser = argparse.ArgumentParser(description="Lead the hand round a circle.")
parser.add_argument("--address", default="ws://localhost:10001")
parser.add_argument("--seconds", type=float, default=20.0)
parser.add_argument("--radius", type=float, default=0.008, help="of the circle [m], as the protocol sees the tool")
parser.add_argument("--stiffness", type=float, default=25.0, help="of the spring [N/m]")
options = parser.parse_args()

with connect(options.address) as socket:
    state = json.loads(socket.recv())  # the first message comes unasked: every device that there is
    device = state["inverse3"][0]["device_id"]
    centre = state["inverse3"][0]["state"]["cursor_position"]
    begin, count, farthest = time.monotonic(), 0, 0.0
    while (now := time.monotonic() - begin) < options.seconds:
        place = state["inverse3"][0]["state"]["cursor_position"]
        angle = 2.0 * math.pi * now / 4.0  # once round in 4 s
        radius = options.radius * min(now, 1.0)  # the first second leads to the circle
        goal = {
            "x": centre["x"] + radius * math.cos(angle),
            "y": centre["y"] + radius * math.sin(angle),
            "z": centre["z"],
        }
        force = {axis: options.stiffness * (goal[axis] - place[axis]) for axis in "xyz"}
        force["z"] = 0.0  # up and down the hand is free
        command = {"device_id": device, "commands": {"set_cursor_force": {"vector": force}}}
        socket.send(json.dumps({"inverse3": [command]}))
        state = json.loads(socket.recv())
        count += 1
        farthest = max(farthest, math.hypot(place["x"] - centre["x"], place["y"] - centre["y"]))

print(f"{count / options.seconds:.0f} forces a second; the tool went {1e3 * farthest:.1f} mm from where it was")
