"""What the programs with pages share: the address on this computer, and the doors. It knows none of the programs."""
