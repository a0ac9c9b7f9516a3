"""Simulated participants: rehearsal, power, duration and heat in advance."""
