"""A session as it runs: trials on the device, stop and resume, the terminal."""
