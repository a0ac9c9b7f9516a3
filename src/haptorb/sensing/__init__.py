"""From what was read to what is so: Sample in, Estimate out."""
