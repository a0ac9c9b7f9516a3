"""A spherical motor, simulated."""
