"""Programs that people start. They do not import each other."""
