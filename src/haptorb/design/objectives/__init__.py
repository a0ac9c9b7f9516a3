"""What a candidate is judged by: one file for each group of objectives and constraints."""
