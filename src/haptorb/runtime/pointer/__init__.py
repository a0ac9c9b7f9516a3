"""The pointer of a console as the hand, and the guided motion while it is not held."""
