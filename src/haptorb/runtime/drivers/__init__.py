"""Drivers of devices: simulated, behind a serial port, or on an I²C bus."""

from haptorb.compiled import load_compiler

load_compiler()  # at import, so that no device waits for it
