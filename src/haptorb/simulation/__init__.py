"""Simulated devices: coils, tool, hand and sensors behind the simulated driver. Deterministic for a seed."""
