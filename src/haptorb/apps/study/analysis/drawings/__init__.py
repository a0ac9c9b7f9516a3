"""Figures of a study for a paper: vector, in millimetres, for every eye, with their fonts inside."""
