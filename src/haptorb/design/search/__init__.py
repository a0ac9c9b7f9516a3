"""Optimisation of a design: the next candidates, generation by generation, from what the last ones came to."""
