"""Independent computations and imitations of hardware, which the product is checked against."""
