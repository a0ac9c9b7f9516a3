"""Single effects: wall, fluid, friction, detents, texture, vibration, magnet, guidance."""
