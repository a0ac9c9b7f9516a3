"""What protects coils and hand: limits, heat, current check, passivity, trips, and the drive."""
