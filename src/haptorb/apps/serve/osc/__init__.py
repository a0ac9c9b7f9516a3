"""`haptorb run --serve osc`: pose, force and buttons out, parameters and forces in, as OSC messages over UDP."""
