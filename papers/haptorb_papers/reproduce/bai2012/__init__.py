"""Statements, tables and figures of Bai 2012."""
