"""Scenes of MuJoCo: bodies, joints and contacts from a file, one body of which the mover holds."""
