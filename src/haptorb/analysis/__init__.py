"""What a device can do and how well: error budget, stability of a loop, coupling to a scene."""
