"""One tick of the loop: read, estimate, world, allocate, guard, write; and the row that it fills."""

from haptorb.numerics.compiled import load_compiler

load_compiler()  # now: no tick waits for the compiler to be loaded
