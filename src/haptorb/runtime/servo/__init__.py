"""The servo as Python programs hold it, and the group of processes behind it."""
