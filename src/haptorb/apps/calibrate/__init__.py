"""`haptorb calibrate DEVICE`: what this very device does per ampere and per watt, measured and kept in a file."""

from __future__ import annotations

from haptorb.apps.calibrate.measure import Pace, calibrate
from haptorb.apps.calibrate.record import ThermalRecord, thermal_record

__all__ = ["Pace", "ThermalRecord", "calibrate", "thermal_record"]
