"""What host and servo tell each other: shared memory, commands, changes of world, reports."""
