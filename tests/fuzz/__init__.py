"""Random and crafted input that tests and benchmarks share."""
