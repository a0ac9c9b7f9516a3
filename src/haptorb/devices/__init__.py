"""What a device is, and what its coils can do at a pose."""
