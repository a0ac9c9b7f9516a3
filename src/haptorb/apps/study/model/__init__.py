"""The study file: set-points, trials, order, and adaptive procedures."""
