"""Worlds with memory: what was done to them before changes what is felt now."""
