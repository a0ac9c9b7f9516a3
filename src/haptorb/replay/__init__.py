"""Replay of recordings: passes the recorded sensor readings through the same chain, and compares every value."""
