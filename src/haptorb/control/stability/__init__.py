"""How stiff a world a sampled, late loop can render."""
