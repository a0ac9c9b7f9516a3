"""Magnetic and thermal calibration of one device."""
