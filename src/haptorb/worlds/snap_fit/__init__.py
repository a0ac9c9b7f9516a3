"""Snap-fits: joining and separating."""
