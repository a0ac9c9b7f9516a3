"""Analysis of devices: error budget, stability of a loop, coupling to a scene."""
