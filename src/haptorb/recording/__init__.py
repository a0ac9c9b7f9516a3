"""The rows of a run: their description, MCAP files, reading, export and plots."""
