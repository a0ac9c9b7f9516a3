"""Statements and figures of Zárate 2020."""
