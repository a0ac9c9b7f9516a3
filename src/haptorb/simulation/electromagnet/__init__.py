"""A spherical electromagnet, simulated."""
