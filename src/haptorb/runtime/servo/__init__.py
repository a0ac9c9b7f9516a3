"""The servo for Python programs, and the group of processes behind it."""
