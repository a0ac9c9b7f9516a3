"""The only room with a clock, a process, a wire or a file."""
