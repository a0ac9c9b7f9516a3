"""Recordings: written as MCAP while a loop runs, read back as arrays."""
