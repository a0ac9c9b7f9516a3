"""Allocation for any number of coils: a whole wrench with the least heat within limits."""
