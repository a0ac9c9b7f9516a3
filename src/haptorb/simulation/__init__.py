"""The physical world behind the simulated driver: coils, tool, hand, sensors. Deterministic for a seed."""
