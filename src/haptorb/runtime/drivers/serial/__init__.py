"""The serial driver: frames, the firmware's replies, and an emulator of its board."""
