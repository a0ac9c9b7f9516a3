"""The processes beside a program: servo, recorder, tracker; and the real-time loop."""

from haptorb.numerics.compiled import load_compiler

load_compiler()  # now: no loop waits for the compiler to be loaded
