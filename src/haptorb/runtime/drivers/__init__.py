"""Drivers of devices: simulated, behind a serial port, or on an I²C bus."""
