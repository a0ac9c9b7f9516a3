"""Simulated participants: forecast, rehearsal and power of a study."""
