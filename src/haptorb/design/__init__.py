"""Search for devices: a design file, what is computed of each candidate, sweeps, optimisation, and their results."""
