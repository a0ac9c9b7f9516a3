"""Torque and field of one pair of parts, tabulated over one angle, and looked up at servo speed."""
