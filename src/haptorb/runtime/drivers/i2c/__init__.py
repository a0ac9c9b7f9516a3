"""The I²C driver: chips, lock, guardian process, and the way back to coils off."""
