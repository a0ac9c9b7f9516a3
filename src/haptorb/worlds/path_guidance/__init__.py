"""Planned guidance: a path, its checks, and a predictive controller of the deviation from it."""
