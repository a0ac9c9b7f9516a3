"""Recordings run again: what the driver had read goes through the same chain, and every number is compared."""
