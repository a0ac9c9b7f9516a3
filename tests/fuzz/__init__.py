"""Random and crafted input for tests and benchmarks."""
