"""What simulations share: coils, hand, tool, noise."""
