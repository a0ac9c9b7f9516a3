"""A metronome to feel, over OSC: each beat pushes the tool; further to the right the tempo is higher.

    haptorb run omni --world nothing --serve osc:9000
    python osc_metronome.py

Any program that speaks OSC can do the same: subscribe, read /haptorb/position, send /haptorb/force. A subscription
expires after 10 s and a force after 50 ms, so that both end with the program.
"""

import argparse
import socket
import time

from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.osc_packet import OscPacket

parser = argparse.ArgumentParser(description="A metronome to feel.")
parser.add_argument("--host", default="127.0.0.1")
parser.add_argument("--port", type=int, default=9000)
parser.add_argument("--seconds", type=float, default=20.0)
parser.add_argument("--strength", type=float, default=0.4, help="force of a beat [N]")
options = parser.parse_args()

SLOWEST, FASTEST = 40.0, 208.0  # beats per minute
BEAT = 0.06  # duration of a push [s]
REACH = 0.02  # of the tool to either side [m]

osc = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
osc.connect((options.host, options.port))
osc.settimeout(0.02)


def send(address, *values):
    message = OscMessageBuilder(address)
    for value in values:
        message.add_arg(value)
    osc.send(message.build().dgram)


begin = time.monotonic()
renew, next_beat, beats, bundles = 0.0, 0.5, 0, 0
position, button = [0.0, 0.0, 0.0], 0
while (now := time.monotonic() - begin) < options.seconds:
    if now >= renew:
        send("/haptorb/subscribe", 0, 200.0)  # to the port that this program sends from, 200 times per second
        renew = now + 3.0
    try:
        for timed in OscPacket(osc.recv(4096)).messages:
            address, values = timed.message.address, timed.message.params
            if address == "/haptorb/position":
                position, bundles = values, bundles + 1
            elif address == "/haptorb/buttons":
                button = values[0]
            elif address == "/haptorb/error":
                print(values[0])
    except (TimeoutError, ConnectionRefusedError):  # no server there, or not yet
        continue
    share = min(max((position[0] + REACH) / (2 * REACH), 0.0), 1.0)
    tempo = SLOWEST + share * (FASTEST - SLOWEST)
    if now >= next_beat:
        beats, next_beat = beats + 1, now + 60.0 / tempo
    since = now - (next_beat - 60.0 / tempo)
    if beats and since < BEAT:
        push = options.strength * (2.0 if button else 1.0)  # twice as strong while button a is held down
        send("/haptorb/force", 0.0, push if beats % 2 else -push, 0.0)
    else:
        send("/haptorb/force", 0.0, 0.0, 0.0)

send("/haptorb/unsubscribe")
print(f"{beats} beats, {bundles / options.seconds:.0f} positions a second")
