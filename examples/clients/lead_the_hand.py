"""Lead the hand along a circle, over WebSocket: a spring pulls the tool to a point that moves on the circle.

    haptorb run omni --serve haply
    python lead_the_hand.py

Each message asks for a force; the reply contains the tool's position, from which the next force follows. A force
expires after 50 ms, so the loop must keep running; when this program ends, so does the force.
"""

import argparse
import json
import math
import time

from websockets.sync.client import connect

parser = argparse.ArgumentParser(description="Lead the hand along a circle.")
parser.add_argument("--address", default="ws://localhost:10001")
parser.add_argument("--seconds", type=float, default=20.0)
parser.add_argument("--radius", type=float, default=0.008, help="of the circle [m], as the protocol sees the tool")
parser.add_argument("--stiffness", type=float, default=25.0, help="of the spring [N/m]")
options = parser.parse_args()

with connect(options.address) as socket:
    state = json.loads(socket.recv())  # the first message comes without a request and lists every device
    device = state["inverse3"][0]["device_id"]
    centre = state["inverse3"][0]["state"]["cursor_position"]
    begin, count, farthest = time.monotonic(), 0, 0.0
    while (now := time.monotonic() - begin) < options.seconds:
        place = state["inverse3"][0]["state"]["cursor_position"]
        angle = 2.0 * math.pi * now / 4.0  # one turn in 4 s
        radius = options.radius * min(now, 1.0)  # the first second leads to the circle
        goal = {
            "x": centre["x"] + radius * math.cos(angle),
            "y": centre["y"] + radius * math.sin(angle),
            "z": centre["z"],
        }
        force = {axis: options.stiffness * (goal[axis] - place[axis]) for axis in "xyz"}
        force["z"] = 0.0  # the hand moves freely up and down
        command = {"device_id": device, "commands": {"set_cursor_force": {"vector": force}}}
        socket.send(json.dumps({"inverse3": [command]}))
        state = json.loads(socket.recv())
        count += 1
        farthest = max(farthest, math.hypot(place["x"] - centre["x"], place["y"] - centre["y"]))

print(f"{count / options.seconds:.0f} forces a second; the tool moved up to {1e3 * farthest:.1f} mm from its start")
