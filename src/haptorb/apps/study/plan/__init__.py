"""What is decided before data exist: the plan of the analysis, and its registration."""
