"""Control: allocation of a wrench to coil currents, haptic linkage, and protection of device and user."""
