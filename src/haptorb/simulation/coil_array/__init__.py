"""A coil array, its tool and a hand, simulated."""
