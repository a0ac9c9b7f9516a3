"""Clocks, deadlines, priorities, and the life of processes."""
