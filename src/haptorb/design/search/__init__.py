"""Optimisation of a design: the next candidates, generation by generation, from the evaluations of the last ones."""
