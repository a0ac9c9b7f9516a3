"""What is asked and what may be answered, for every program that asks: pure state machines, no clock and no file."""
