"""Servers beside the loop (`haptorb run --serve`): other programs feel the device, steer it and look at its rows."""
