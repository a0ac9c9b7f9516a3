"""MuJoCo scenes: bodies, joints and contacts from a file; the mover holds one of the bodies."""
