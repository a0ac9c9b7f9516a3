"""Recordings of runs: row layout, MCAP files, reading, repair, export and plots."""
