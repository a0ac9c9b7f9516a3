"""From a wanted wrench to currents that may be applied."""
