"""What answers, what it reads, and one coil moved gently: the tools for bringing a device up."""
