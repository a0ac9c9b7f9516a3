"""Worlds with memory: their wrench depends on the past."""
