"""One tick of the loop: read, estimate, world, allocate, guard, write; and the row that it fills."""
