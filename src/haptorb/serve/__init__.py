"""Servers beside the loop (`haptorb run --serve`): other programs read its rows and command forces."""
