"""Any number of round coils anywhere, an optional soft sphere, and a tool with magnets."""
