"""Independent computations, imitations of hardware, and what a user writes: what the product is checked against."""
