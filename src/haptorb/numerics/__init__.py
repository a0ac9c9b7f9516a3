"""Array types, compiled kernels and rotations: the tools of every other package."""
