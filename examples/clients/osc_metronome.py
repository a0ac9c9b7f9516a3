"""A metronome that is felt, over OSC: each beat is a push of the tool; further to the right it beats faster.

    haptorb run omni --world nothing --serve osc:9000
    python osc_metronome.py

Any program with OSC does the same: subscribe, read /haptorb/position, send /haptorb/force. A subscription holds for
10 s and a force for 50 ms, so that nothing goes on when a program has ended.
"""

import argparse
import socket
import time

from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.osc_packet import OscPacket

parser = argparse.ArgumentParser(description="A metronome that is felt.")
parser.add_argument("--host", default="127.0.0.1")
parser.add_argument("--port", type=int, default=9000)
parser.add_argument("--seconds", type=float, default=20.0)
parser.add_argument("--strength", type=float, default=0.4, help="of a beat [N]")
options = parser.parse_args()

SLOWEST, FASTEST = 40.0, 208.0  # beats a minute
BEAT = 0.06  # how long a push lasts [s]
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
        send("/haptorb/subscribe", 0, 200.0)  # to the port that I send from, 200 times a second
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
    except (TimeoutError, ConnectionRefusedError):  # nobody serves there, or not yet
        continue
    share = min(max((position[0] + REACH) / (2 * REACH), 0.0), 1.0)
    tempo = SLOWEST + share * (FASTEST - SLOWEST)
    if now >= next_beat:
        beats, next_beat = beats + 1, now + 60.0 / tempo
    since = now - (next_beat - 60.0 / tempo)
    if beats and since < BEAT:
        push = options.strength * (2.0 if button else 1.0)  # with button a held down: twice as strong
        send("/haptorb/force", 0.0, push if beats % 2 else -push, 0.0)
    else:
        send("/haptorb/force", 0.0, 0.0, 0.0)

send("/haptorb/unsubscribe")
print(f"{beats} beats, {bundles / options.seconds:.0f} positions a second")
