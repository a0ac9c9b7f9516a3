"""Snap-fits that go together and come apart."""
