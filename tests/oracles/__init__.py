"""Independent computations, emulated hardware and user code against which the product is checked."""
