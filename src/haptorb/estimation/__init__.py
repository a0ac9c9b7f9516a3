"""State estimation: from the sensor readings of a tick (Sample) to the mover's state (Estimate)."""
