"""Memory that processes share without locks: ring, sequence locks, text, histogram."""
