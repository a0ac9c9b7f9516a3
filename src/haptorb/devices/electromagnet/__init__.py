"""Spherical electromagnets that push and pull a magnet in a tool: the Omni of Zárate 2020 and its relatives."""
